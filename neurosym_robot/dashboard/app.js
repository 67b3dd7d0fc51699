// Ties it together: what is chosen, and what is drawn when.

const KEPT = 64e6; // characters of a live stream that the page keeps
const STALE = 2000; // milliseconds without data after which what is shown is not live
const AGES = 5; // choices of when the forecast shown was made

class App {
  constructor(introduction, live) {
    this.recording = new Recording(introduction, live ? KEPT : Infinity);
    this.style = looks(this.recording.models);
    this.pair = ["", ""];
    this.chosen = false; // the pair by hand; otherwise the most interesting
    this.redraw = this.redraw.bind(this);
    this.stage = new Stage(find("scene"), this.redraw);
    this.stage.setMap(this.recording.map);
    this.player = new Player(this.recording, live, this.redraw);
    this.panels = new Panels(this.recording, this.style, (pair) => this.choose(pair));
    document.title = this.recording.title || "People and forecasts";
    say(find("title"), document.title);
    this.layers = new Layers(this.recording, this.style, this.redraw);
    new ResizeObserver(this.redraw).observe(find("scene"));
    matchMedia("(prefers-color-scheme: dark)").onchange = () => this.recolour();
    this.recolour();
    this.heard = performance.now();
    if (live) setInterval(() => this.showStatus(), 500);
  }

  add(line) {
    this.heard = performance.now();
    const gone = this.recording.add(line);
    if (!this.recording.length) return;
    const { step, at, robot } = this.recording.moments.at(-1);
    // The view follows those who are forecast: a tracker's ghosts may be anywhere.
    const { view } = this.stage;
    if (step) view.include(this.places(step));
    else if (!view.bounds) view.include(at.values());
    if (robot) view.include([robot]);
    if (step && this.ages === undefined) this.offerAges(step);
    this.player.grew(gone);
    this.redraw();
  }

  offerAges(step) {
    const { recording } = this;
    const steps = recording.horizon(step);
    this.ages = Array.from({ length: AGES }, (_, n) => Math.round((n * steps) / (AGES - 1)) * recording.period);
    find("age").replaceChildren(...this.ages.map((age) => (
      make("option", age ? `${age.toFixed(1)} s ago` : "now", { value: age }))));
  }

  // Where people of a forecast are, and where each model's most central sample ends.
  places(step) {
    const last = step.seen.map((flat) => flat.slice(-2));
    const ends = Object.values(step.models).flatMap(({ samples, central }) => samples.map((each, n) => {
      const [x, y] = each[central].slice(-2);
      return [last[n][0] + x / 100, last[n][1] + y / 100];
    }));
    return [...last, ...ends];
  }

  fit() {
    this.stage.view.fit(this.recording.steps.flatMap((step) => this.places(step)));
    this.redraw();
  }

  choose(pair) {
    this.pair = pair;
    this.chosen = true;
    this.redraw();
  }

  // The two who are nearest and nearing, until one of them is gone; or those who were chosen. Whoever
  // nears at 1 m/s counts as two seconds nearer.
  updatePair(step) {
    if (!step || step.ids.length < 2 || this.chosen) return;
    if (this.pair.every((id) => step.row.has(id))) return;
    const apart = (i, j, end) => {
      const [a, b] = [i, j].map((n) => step.seen[n].slice(end - 2, end || undefined));
      return Math.hypot(a[0] - b[0], a[1] - b[1]);
    };
    let least = Infinity;
    for (let i = 0; i < step.ids.length; i += 1) {
      for (let j = i + 1; j < step.ids.length; j += 1) {
        const now = apart(i, j, 0);
        const nearing = (apart(i, j, -2) - now) / this.recording.period;
        if (now - 2 * nearing < least) {
          least = now - 2 * nearing;
          this.pair = [step.ids[i], step.ids[j]];
        }
      }
    }
  }

  // The page chooses the pair again.
  freePair() {
    this.chosen = false;
    this.pair = ["", ""];
    this.redraw();
  }

  nextPair() {
    const { ids } = this.recording.stepAt(this.player.moment, this.age) ?? { ids: [] };
    const pairs = ids.flatMap((k) => ids.filter((l) => l !== k).map((l) => [k, l]));
    if (!pairs.length) return;
    const at = pairs.findIndex(([k, l]) => k === this.pair[0] && l === this.pair[1]);
    this.choose(pairs[(at + 1) % pairs.length]);
  }

  click(x, y) {
    const id = this.stage.personAt(x, y);
    if (id === null) return;
    // The first click chooses k, the next one l.
    if (this.first && this.first !== id) {
      this.choose([this.first, id]);
      this.first = null;
    } else {
      this.first = id;
      this.choose([id, this.pair.find((other) => other !== id) ?? id]);
    }
  }

  get age() { return Number(find("age").value) || 0; }

  redraw() {
    this.waiting ??= requestAnimationFrame(() => {
      this.waiting = null;
      this.draw();
    });
  }

  draw() {
    const { player, recording } = this;
    const { moment } = player;
    const latest = moment?.latest ?? null;
    const step = recording.stepAt(moment, this.age);
    this.updatePair(step);
    const places = player.places();
    this.stage.draw({
      places, latest, step, robot: moment?.robot, pair: this.pair, shown: this.layers.shown, style: this.style,
      truth: step ? recording.truth(step) : new Map(), current: step === latest,
    });
    this.panels.show({ moment, step, latest, pair: this.pair });
    this.showTime();
    find("invitation").hidden = Boolean(moment?.at.size);
    this.describe(places, step);
  }

  showTime() {
    const { player, recording } = this;
    const clock = (t) => `${Math.floor(t / 60)}:${(t % 60).toFixed(1).padStart(4, "0")}`;
    const begin = recording.moments[0]?.t ?? 0;
    const now = (player.moment?.t ?? 0) - begin;
    const end = (recording.moments.at(-1)?.t ?? 0) - begin;
    const slider = find("timeline");
    slider.max = Math.max(0, recording.length - 1);
    slider.value = player.index;
    slider.setAttribute("aria-valuetext", `${clock(now)} of ${clock(end)}`);
    say(find("clock"), `${clock(now)} / ${clock(end)}`);
    const running = player.playing || player.following;
    find("play").classList.toggle("playing", running);
    find("play").setAttribute("aria-label", running ? "Pause" : "Play");
    find("live").hidden = !player.live;
    find("live").setAttribute("aria-pressed", String(player.following));
    this.showStatus();
  }

  showStatus() {
    const { player } = this;
    const silence = this.ended ? 0 : performance.now() - this.heard;
    const state = this.lost ? "lost"
      : player.following ? (silence > STALE ? "stale" : "live") : player.playing ? "playing" : "paused";
    find("status").className = state;
    const words = {
      lost: "connection lost, trying again",
      stale: `stale: nothing heard for ${Math.floor(silence / 1000)} s`,
      live: "live",
      playing: "playing",
      paused: "paused",
    };
    const behind = player.live && !player.following && !this.lost ? ", live goes on" : "";
    const alarm = { lost: "Connection lost: this is not now", stale: `No people for ${Math.floor(silence / 1000)} s: this is not now` };
    find("alarm").hidden = !alarm[state] || !this.recording.length;
    say(find("alarm"), alarm[state] ?? "");
    find("auto").setAttribute("aria-pressed", String(!this.chosen));
    say(find("status"), words[state] + behind + (this.ended && state !== "lost" ? ", recording ended" : ""));
  }

  // For those who do not see the canvas; not while it moves, which nobody could listen to.
  describe(places, step) {
    if (this.player.playing || (this.player.following && performance.now() - (this.described ?? -Infinity) < 1000)) return;
    this.described = performance.now();
    const people = [...places].slice(0, 8).map(([id, [x, y]]) => `${id} at ${x.toFixed(1)}, ${y.toFixed(1)}`);
    const text = `${places.size} people seen, ${step?.ids.length ?? 0} forecast. ${people.join("; ")}`;
    find("scene").setAttribute("aria-label", text);
  }

  recolour() {
    this.stage.readColours();
    this.layers.drawSamples(this.stage.colour);
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

  cycleAge() {
    const select = find("age");
    select.selectedIndex = (select.selectedIndex + 1) % Math.max(1, select.options.length);
    this.redraw();
  }
}
