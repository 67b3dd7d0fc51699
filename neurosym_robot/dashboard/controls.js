// Buttons, keys and the pointer.

class Controls {
  constructor(app) {
    this.app = app;
    const { player } = app;
    find("play").onclick = () => player.toggle();
    find("back").onclick = () => player.skip(-1);
    find("forth").onclick = () => player.skip(1);
    find("live").onclick = () => player.follow();
    find("fit").onclick = () => app.fit();
    find("theme").onclick = () => app.turnTheme();
    find("auto").onclick = () => app.freePair();
    find("help").onclick = () => find("keys").showModal();
    find("age").onchange = app.redraw;
    find("speed").onchange = () => { player.speed = Number(find("speed").value); };
    find("timeline").oninput = () => {
      player.pause();
      player.go(Number(find("timeline").value));
    };
    window.onkeydown = (event) => this.key(event);
    this.listenToPointer(find("scene"));
  }

  listenToPointer(scene) {
    let from = null;
    let moved = false;
    scene.onpointerdown = (event) => {
      scene.setPointerCapture(event.pointerId);
      from = [event.offsetX, event.offsetY];
      moved = false;
    };
    scene.onpointermove = (event) => {
      if (!from) return;
      const [dx, dy] = [event.offsetX - from[0], event.offsetY - from[1]];
      if (!moved && Math.hypot(dx, dy) < 4) return;
      moved = true;
      from = [event.offsetX, event.offsetY];
      this.app.stage.view.move(dx, dy);
      this.app.redraw();
    };
    scene.onpointerup = (event) => {
      if (from && !moved) this.app.click(event.offsetX, event.offsetY);
      from = null;
    };
    scene.onpointercancel = () => { from = null; };
    scene.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(1.0015 ** -event.deltaY, event.offsetX, event.offsetY);
    }, { passive: false });
  }

  zoom(...about) {
    this.app.stage.view.zoom(...about);
    this.app.redraw();
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || find("keys").open) return;
    const { target, key } = event;
    // What a control does with a key of its own is left to it.
    if (target.matches("select") && key !== "?") return;
    if (key === " " && target.matches("button, input[type=checkbox]") && target.id !== "play") return;
    const { app } = this;
    const { player } = app;
    const actions = {
      " ": () => player.toggle(),
      ArrowLeft: () => player.skip(event.shiftKey ? -10 : -1),
      ArrowRight: () => player.skip(event.shiftKey ? 10 : 1),
      Home: () => { player.pause(); player.go(0); },
      End: () => (player.live ? player.follow() : player.go(app.recording.length - 1)),
      l: () => player.live && player.follow(),
      a: () => app.cycleAge(),
      p: () => app.nextPair(),
      Escape: () => app.freePair(),
      f: () => app.fit(),
      t: () => app.turnTheme(),
      "+": () => this.zoom(1.25),
      "=": () => this.zoom(1.25),
      "-": () => this.zoom(0.8),
      "?": () => find("keys").showModal(),
    };
    const action = actions[key.length === 1 ? key.toLowerCase() : key]
      ?? (/[1-9]/.test(key) ? () => app.layers.toggle(Number(key) - 1) : null);
    if (!action) return;
    event.preventDefault();
    action();
  }
}
