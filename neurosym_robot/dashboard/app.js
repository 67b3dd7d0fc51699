// Ties it together: where the data comes from, which moment is shown, and what is drawn when.

const KEPT = 64e6; // characters of a live stream that the page keeps

class App {
  constructor(introduction, live) {
    this.recording = new Recording(introduction, live ? KEPT : Infinity);
    Object.assign(this, { live, following: live, playing: !live, index: 0, pair: ["", ""], fresh: null });
    document.title = this.recording.title || "People and forecasts";
    say(find("title"), document.title);
    this.stage = new Stage(find("scene"), this.recording);
    this.panels = new Panels(this.recording, this.stage.style, (pair) => this.choose(pair));
    this.offerLayers();
    find("layers").open = innerWidth > 860; // on a phone it would cover people
    this.listen();
    new ResizeObserver(() => this.redraw()).observe(find("scene"));
    matchMedia("(prefers-color-scheme: dark)").onchange = () => this.recolour();
    this.recolour();
    setInterval(() => this.showStatus(), 250);
    if (this.playing) this.play();
  }

  add(line) {
    const gone = this.recording.add(line);
    const moment = this.recording.moments.at(-1);
    if (!moment) return;
    if (this.fresh) this.note(moment.now.lag ?? 0, moment.now.rate);
    // The view follows those who are forecast: a tracker's ghosts may be anywhere.
    const { stage } = this;
    if (moment.step) stage.include(this.recording.ends(moment.step));
    else if (!stage.bounds) stage.include(moment.at.values());
    if (moment.robot) stage.include([moment.robot]);
    this.index = this.following ? this.recording.length - 1 : Math.max(0, this.index - gone);
    this.redraw();
  }

  // How old the newest people are, as the server says; until it has, what comes is history.
  note(age, rate) {
    this.fresh = { age: age ?? Infinity, rate, at: performance.now() };
    this.showStatus();
  }

  offerLayers() {
    const names = [...this.recording.models, "observed", "what happened", "ids"];
    if (this.recording.place) names.push("learned");
    if (this.recording.map) names.push("map");
    this.shown = new Set(names);
    find("layers").append(...names.map((name) => {
      const label = make("label", "", { title: name });
      const box = make("input", "", { type: "checkbox", checked: true });
      box.onchange = () => {
        this.shown[box.checked ? "add" : "delete"](name);
        this.redraw();
      };
      const swatch = make("i");
      const look = this.stage.style.get(name);
      if (look !== undefined) swatch.style.background = `var(--model-${look})`;
      label.append(box, swatch, name);
      return label;
    }));
  }

  choose(pair) {
    this.pair = pair.map((id) => id ?? "");
    this.redraw();
  }

  fit() {
    this.stage.fits = true;
    this.stage.bounds = null;
    const moment = this.recording.moments[this.index];
    this.stage.include([...(moment?.at.values() ?? []), ...(moment?.robot ? [moment.robot] : [])]);
    this.redraw();
  }

  go(index) {
    this.following = this.playing = false;
    this.index = Math.min(Math.max(index, 0), Math.max(0, this.recording.length - 1));
    this.redraw();
  }

  // On or back by so many forecasts; where there are none, by moments.
  skip(count) {
    const { moments } = this.recording;
    const direction = Math.sign(count);
    let index = this.index;
    for (let left = Math.abs(count); left > 0; left -= 1) {
      do index += direction; while (moments[index] && !moments[index].step);
    }
    this.go(index);
  }

  follow() {
    [this.following, this.playing] = [this.live, false];
    this.index = Math.max(0, this.recording.length - 1);
    this.redraw();
  }

  toggle() {
    if (this.playing || this.following) return this.go(this.index);
    const atEnd = this.index >= this.recording.length - 1;
    if (atEnd && this.live) return this.follow();
    if (atEnd) this.index = 0;
    this.play();
  }

  // Moments one after the other at their own pace; a silence is not sat through.
  play() {
    this.playing = true;
    let before = performance.now();
    let left = 0;
    const tick = (now) => {
      if (!this.playing) return;
      const { moments } = this.recording;
      left += Math.min(now - before, 250) / 1000;
      before = now;
      while (this.index < moments.length - 1) {
        const gap = Math.min(moments[this.index + 1].t - moments[this.index].t, 1);
        if (gap > left) break;
        left -= gap;
        this.index += 1;
      }
      if (moments.length && this.index === moments.length - 1) {
        this.playing = false;
        this.following = this.live;
      }
      this.redraw();
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  redraw() {
    this.waiting ??= requestAnimationFrame(() => {
      this.waiting = null;
      this.draw();
    });
  }

  draw() {
    const { recording, index } = this;
    const moment = recording.moments[index];
    this.stage.draw({ moment, shown: this.shown, chosen: this.pair, past: !this.following });
    this.panels.show(index, this.pair);
    const clock = (t) => `${Math.floor(t / 60)}:${(t % 60).toFixed(1).padStart(4, "0")}`;
    const begin = recording.moments[0]?.t ?? 0;
    const [now, end] = [moment, recording.moments.at(-1)].map((each) => clock((each?.t ?? 0) - begin));
    const slider = find("timeline");
    slider.max = Math.max(0, recording.length - 1);
    slider.value = index;
    slider.setAttribute("aria-valuetext", `${now} of ${end}`);
    say(find("clock"), `${now} / ${end}`);
    this.showStatus();
    // For those who do not see the canvas; not while it moves, which nobody could listen to.
    if (this.playing || (this.following && performance.now() - (this.described ?? -1e9) < 1000)) return;
    this.described = performance.now();
    const people = [...(moment?.at ?? [])].slice(0, 8).map(([id, [x, y]]) => `${id} at ${x.toFixed(1)}, ${y.toFixed(1)}`);
    const counts = `${moment?.at.size ?? 0} people seen, ${moment?.latest?.ids.length ?? 0} forecast`;
    find("scene").setAttribute("aria-label", `${counts}. ${people.join("; ")}`);
  }

  // Seconds since the stamp of the newest people, beyond a constant offset of clocks.
  get age() {
    return this.fresh ? this.fresh.age + (performance.now() - this.fresh.at) / 1000 : Infinity;
  }

  showStatus() {
    const moment = this.recording.moments[this.index];
    const limit = moment?.now.stale_after ?? Infinity;
    const now = this.live && this.following;
    const live = !this.fresh ? "history" : this.age > limit ? "stale" : "live";
    const state = this.lost ? "lost" : now ? live : this.playing ? "playing" : "paused";
    find("status").className = state;
    const seconds = Math.floor(this.age);
    const words = {
      lost: "connection lost, trying again",
      stale: Number.isFinite(seconds) ? `stale for ${seconds} s` : "no people yet",
      history: "what was kept so far, not live",
    };
    if (moment && now) this.panels.showTiles(moment, this.fresh && { age: this.age, rate: live === "stale" ? 0 : this.fresh.rate });
    const behind = this.live && !this.following && !this.lost ? ", live goes on" : "";
    say(find("status"), (words[state] ?? state) + behind + (this.ended ? ", recording ended" : ""));
    const alarm = {
      lost: "Connection lost: this is not now",
      stale: `The newest people are ${seconds} s old: this is not now`,
    }[state];
    find("alarm").hidden = !alarm || !this.recording.length;
    say(find("alarm"), alarm ?? "");
    say(find("play"), this.playing || this.following ? "Pause" : "Play");
    find("live").hidden = !this.live;
    find("live").setAttribute("aria-pressed", String(this.following));
  }

  recolour() {
    this.stage.readColours();
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    const root = document.documentElement.classList;
    say(find("theme"), root.contains("dark") || (dark && !root.contains("light")) ? "Light" : "Dark");
    this.redraw();
  }

  turnTheme() {
    const wanted = find("theme").textContent.toLowerCase();
    document.documentElement.classList.remove("light", "dark");
    document.documentElement.classList.add(wanted);
    this.recolour();
  }

  listen() {
    const zoom = (...about) => { this.stage.zoom(...about); this.redraw(); };
    find("play").onclick = () => this.toggle();
    find("live").onclick = () => this.follow();
    find("fit").onclick = () => this.fit();
    find("theme").onclick = () => this.turnTheme();
    find("timeline").oninput = () => this.go(Number(find("timeline").value));
    const actions = {
      " ": () => this.toggle(),
      ArrowLeft: (event) => this.skip(event.shiftKey ? -10 : -1),
      ArrowRight: (event) => this.skip(event.shiftKey ? 10 : 1),
      Home: () => this.go(0),
      End: () => (this.live ? this.follow() : this.go(Infinity)),
      Escape: () => this.choose(["", ""]),
      l: () => this.live && this.follow(),
      f: () => this.fit(),
      t: () => this.turnTheme(),
      "+": () => zoom(1.25),
      "-": () => zoom(0.8),
    };
    window.onkeydown = (event) => {
      const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
      if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
      // What a control does with a key of its own is left to it.
      if (event.target.matches("select") || (event.key === " " && event.target.matches("button, input[type=checkbox], summary"))) return;
      event.preventDefault();
      action(event);
    };
    const scene = find("scene");
    let [from, moved] = [null, false];
    scene.onpointerdown = (event) => {
      scene.setPointerCapture(event.pointerId);
      [from, moved] = [[event.offsetX, event.offsetY], false];
    };
    scene.onpointermove = (event) => {
      if (!from) return;
      const [dx, dy] = [event.offsetX - from[0], event.offsetY - from[1]];
      if (!moved && Math.hypot(dx, dy) < 4) return;
      [from, moved] = [[event.offsetX, event.offsetY], true];
      this.stage.move(dx, dy);
      this.redraw();
    };
    scene.onpointerup = (event) => {
      const id = from && !moved ? this.stage.personAt(event.offsetX, event.offsetY) : null;
      if (id !== null && id !== this.pair[0]) this.choose([id, this.pair[0]]);
      from = null;
    };
    scene.onpointercancel = () => { from = null; };
    scene.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoom(1.0015 ** -event.deltaY, event.offsetX, event.offsetY);
    }, { passive: false });
  }
}

// Follow the stream; what was missed is sent again, and after a restart everything is new.
function openStream() {
  const source = new EventSource("events");
  let introduction = null;
  let app = null;
  source.addEventListener("introduction", (event) => { introduction = JSON.parse(event.data); });
  source.addEventListener("anew", () => {
    if (app) return location.reload();
    app = new App(introduction, true);
  });
  source.onmessage = (event) => app.add(event.data);
  source.addEventListener("beat", (event) => {
    const { age, rate } = JSON.parse(event.data);
    app.note(age, rate);
  });
  source.addEventListener("end", () => {
    source.close();
    app.ended = true;
    app.live = app.following = false;
    app.redraw();
  });
  source.onopen = () => { if (app) app.lost = false; };
  source.onerror = () => {
    if (app) [app.lost, app.fresh] = [true, null]; else say(find("status"), "no connection, trying again");
  };
}

const embedded = find("recording").textContent.trim();
if (embedded) {
  const [introduction, ...lines] = embedded.split("\n");
  const app = new App(JSON.parse(introduction), false);
  lines.forEach((line) => app.add(line));
} else {
  openStream();
}
