// The scene from above on a canvas: the floor, people, where they were, and where they may go.

// Dashes say which model it is, too; the same in our figures. Lengths are in widths of the line.
const DASHES = [[0.1, 1.9], [5, 2, 0.1, 2], [4, 2], [8, 2, 2, 2]];

// Which colour and dashes a model has: NeuroSyM and SGAN always theirs.
function looks(models) {
  const taken = new Map();
  for (const name of models) {
    const wanted = /neurosym/i.test(name) ? 0 : /sgan/i.test(name) ? 1 : 2;
    const free = [wanted, 2, 3, 1, 0].find((n) => ![...taken.values()].includes(n));
    taken.set(name, free ?? 3);
  }
  return taken;
}

class Stage {
  constructor(canvas, redraw) {
    this.canvas = canvas;
    this.redraw = redraw;
    this.pen = canvas.getContext("2d");
    this.view = new View(canvas);
    this.hits = []; // people on the screen, for the pointer
    this.readColours();
  }

  readColours() {
    const probe = document.createElement("i");
    document.body.append(probe);
    this.colour = {};
    for (const name of ["ink", "quiet", "grid", "floor", "wall", "truth", "pair",
      "model-0", "model-1", "model-2", "model-3"]) {
      probe.style.color = `var(--${name})`;
      this.colour[name] = getComputedStyle(probe).color;
    }
    probe.remove();
    this.tinted = null;
  }

  // The map underneath: an image that is as opaque as the floor is occupied.
  setMap(map) {
    this.map = map;
    this.tinted = null;
    if (!map) return;
    this.image = new Image();
    this.image.onload = this.redraw;
    this.image.src = map.image;
  }

  // Adopt the size of the window, and the view that follows from it.
  measure() {
    this.view.measure();
    const { width, height } = this.view;
    const density = window.devicePixelRatio || 1;
    const [w, h] = [Math.round(width * density), Math.round(height * density)];
    if (this.canvas.width !== w || this.canvas.height !== h) {
      [this.canvas.width, this.canvas.height] = [w, h];
    }
    this.pen.setTransform(density, 0, 0, density, 0, 0);
    this.pen.clearRect(0, 0, width, height);
    this.em = this.view.em;
  }

  // what: people [[id, [x, y]]], step, truth, pair [k, l], shown (a set of layers), style, labels
  draw(what) {
    this.measure();
    this.drawGrid();
    if (what.shown.has("map")) this.drawMap();
    const { step } = what;
    if (step) {
      const last = step.seen.map((flat) => flat.slice(-2));
      if (what.shown.has("truth")) this.drawTruth(what.truth);
      for (const [name, result] of Object.entries(step.models)) {
        if (what.shown.has(`model ${name}`)) this.drawFan(result, last, what.style.get(name));
      }
      if (what.shown.has("observed")) this.drawObserved(step, what);
    }
    if (what.shown.has("pair")) this.drawPair(what);
    if (what.robot) this.drawRobot(what.robot);
    this.drawPeople(what);
    this.drawScale();
  }

  line(points, close = false) {
    this.pen.beginPath();
    points.forEach((point, n) => this.pen[n ? "lineTo" : "moveTo"](...this.view.toScreen(point)));
    if (close) this.pen.closePath();
  }

  drawMap() {
    if (!this.map || !this.image.complete || !this.image.naturalWidth) return;
    if (!this.tinted) {
      const [w, h] = [this.image.naturalWidth, this.image.naturalHeight];
      this.tinted = new OffscreenCanvas(w, h);
      const pen = this.tinted.getContext("2d");
      pen.drawImage(this.image, 0, 0);
      pen.globalCompositeOperation = "source-in";
      pen.fillStyle = this.colour.wall;
      pen.fillRect(0, 0, w, h);
    }
    const { width, height, origin: [x, y, yaw] } = this.map;
    const { pen } = this;
    pen.save();
    pen.translate(...this.view.toScreen([x, y]));
    pen.rotate(-yaw);
    pen.imageSmoothingEnabled = (width / this.tinted.width) * this.view.scale < 2;
    pen.globalAlpha = 0.75;
    pen.drawImage(this.tinted, 0, -height * this.view.scale, width * this.view.scale, height * this.view.scale);
    pen.restore();
  }

  drawGrid() {
    const { pen, view } = this;
    const { width, height, gridStep: size } = view;
    const [left, top] = view.toWorld(0, 0);
    const [right, bottom] = view.toWorld(width, height);
    pen.strokeStyle = this.colour.grid;
    pen.lineWidth = 1;
    pen.beginPath();
    for (let x = Math.ceil(left / size) * size; x <= right; x += size) {
      const at = Math.round(view.toScreen([x, 0])[0]) + 0.5;
      pen.moveTo(at, 0);
      pen.lineTo(at, height);
    }
    for (let y = Math.ceil(bottom / size) * size; y <= top; y += size) {
      const at = Math.round(view.toScreen([0, y])[1]) + 0.5;
      pen.moveTo(0, at);
      pen.lineTo(width, at);
    }
    pen.stroke();
  }

  drawScale() {
    const { pen, em, view } = this;
    const [right, y, length] = [view.width - em, view.height - em, view.gridStep * view.scale];
    pen.strokeStyle = pen.fillStyle = this.colour.quiet;
    pen.lineWidth = 1.5;
    pen.beginPath();
    pen.moveTo(right - length, y - 0.35 * em);
    pen.lineTo(right - length, y);
    pen.lineTo(right, y);
    pen.lineTo(right, y - 0.35 * em);
    pen.stroke();
    Object.assign(pen, { font: this.font(0.85), textAlign: "center", textBaseline: "bottom" });
    this.write(`${+view.gridStep.toPrecision(1)} m`, right - length / 2, y - 0.15 * em);
  }

  // Pale and broad, so that a forecast on it can still be seen.
  drawTruth(paths) {
    const { pen } = this;
    Object.assign(pen, { strokeStyle: this.colour.truth, lineCap: "round", lineJoin: "round" });
    pen.lineWidth = 0.6 * this.em;
    pen.globalAlpha = 0.4;
    for (const path of paths.values()) {
      if (path.length < 2) continue;
      this.line(path);
      pen.stroke();
    }
    pen.globalAlpha = 1;
  }

  drawFan({ samples, central }, last, look) {
    const { pen } = this;
    const count = samples[0]?.length ?? 0;
    const path = (n, flat) => {
      const [x, y] = last[n];
      const points = [last[n]];
      for (let at = 0; at < flat.length; at += 2) points.push([x + flat[at] / 100, y + flat[at + 1] / 100]);
      return points;
    };
    Object.assign(pen, { lineCap: "round", lineJoin: "round" });
    pen.strokeStyle = pen.fillStyle = this.colour[`model-${look}`];
    pen.lineWidth = 0.075 * this.em;
    pen.globalAlpha = Math.min(0.9, 5 / count);
    for (let k = 0; k < count; k += 1) {
      pen.beginPath();
      samples.forEach((each, n) => path(n, each[k]).forEach((point, m) => {
        pen[m ? "lineTo" : "moveTo"](...this.view.toScreen(point));
      }));
      pen.stroke();
    }
    pen.globalAlpha = 1;
    pen.lineWidth = 0.2 * this.em;
    pen.setLineDash(DASHES[look].map((length) => length * pen.lineWidth));
    samples.forEach((each, n) => {
      const points = path(n, each[central]);
      this.line(points);
      pen.stroke();
    });
    pen.setLineDash([]);
    samples.forEach((each, n) => this.dot(path(n, each[central]).at(-1), 0.24 * this.em));
  }

  font(size, weight = 400) {
    return `${weight} ${size * this.em}px system-ui, sans-serif`;
  }

  // Text with a halo of the floor's colour, which keeps it legible on lines.
  write(text, x, y) {
    Object.assign(this.pen, { lineWidth: 0.28 * this.em, lineJoin: "round", strokeStyle: this.colour.floor });
    this.pen.strokeText(text, x, y);
    this.pen.fillText(text, x, y);
  }

  dot(place, radius) {
    this.pen.beginPath();
    this.pen.arc(...this.view.toScreen(place), radius, 0, 7);
    this.pen.fill();
  }

  // What nobody saw but was extrapolated is hollow.
  drawObserved(step, { places, current }) {
    const { pen } = this;
    Object.assign(pen, { strokeStyle: this.colour.ink });
    Object.assign(pen, { lineWidth: 0.1 * this.em, lineJoin: "round" });
    step.ids.forEach((id, n) => {
      const flat = step.seen[n];
      const points = Array.from({ length: flat.length / 2 }, (_, t) => [flat[2 * t], flat[2 * t + 1]]);
      this.line(current && places.has(id) ? [...points, places.get(id)] : points);
      pen.stroke();
      const seen = points.length - step.extrapolated[n];
      points.forEach((point, t) => {
        pen.fillStyle = t < seen ? this.colour.ink : this.colour.floor;
        this.dot(point, 0.14 * this.em);
        if (t >= seen) pen.stroke();
      });
    });
  }

  // A square, whose corner in front says where it looks.
  drawRobot([x, y, yaw]) {
    const { pen } = this;
    pen.save();
    pen.translate(...this.view.toScreen([x, y]));
    pen.rotate(-yaw);
    pen.scale(this.em, this.em);
    pen.beginPath();
    for (const [along, across] of [[-0.55, -0.55], [0.35, -0.55], [1, 0], [0.35, 0.55], [-0.55, 0.55]]) {
      pen.lineTo(along, across);
    }
    pen.closePath();
    Object.assign(pen, { fillStyle: this.colour.floor, strokeStyle: this.colour.ink, lineWidth: 0.16 });
    pen.fill();
    pen.stroke();
    pen.restore();
    Object.assign(pen, { font: this.font(0.85), textAlign: "center", textBaseline: "top", fillStyle: this.colour.quiet });
    const [left, top] = this.view.toScreen([x, y]);
    this.write("robot", left, top + 0.9 * this.em);
  }

  drawPair({ places, pair: [k, l] }) {
    const [a, b] = [places.get(k), places.get(l)];
    if (!a || !b) return;
    const { pen } = this;
    Object.assign(pen, { strokeStyle: this.colour.pair, lineWidth: 0.12 * this.em });
    pen.setLineDash([0.35 * this.em, 0.3 * this.em]);
    this.line([a, b]);
    pen.stroke();
    pen.setLineDash([]);
    for (const place of [a, b]) {
      pen.beginPath();
      pen.arc(...this.view.toScreen(place), 0.8 * this.em, 0, 7);
      pen.stroke();
    }
  }

  drawPeople({ places, latest, pair, shown }) {
    const { pen, em } = this;
    this.hits = [];
    Object.assign(pen, { font: this.font(0.95, 600), textAlign: "left", textBaseline: "middle" });
    for (const [id, place] of places) {
      const known = latest?.row.has(id);
      const [x, y] = this.view.toScreen(place);
      this.hits.push({ id, x, y });
      pen.beginPath();
      pen.arc(x, y, 0.42 * em, 0, 7);
      pen.lineWidth = 0.14 * em;
      pen.fillStyle = known ? this.colour.ink : this.colour.floor;
      pen.strokeStyle = known ? this.colour.floor : this.colour.quiet;
      pen.fill();
      pen.stroke();
      const role = shown.has("pair") && pair[0] !== pair[1] ? ["k", "l"][pair.indexOf(id)] : null;
      const text = role ? `${shorten(id)} ${role}` : shorten(id);
      pen.fillStyle = role ? this.colour.pair : known ? this.colour.ink : this.colour.quiet;
      this.write(text, x + (role ? 1.05 : 0.75) * em, y - 0.75 * em);
    }
  }

  // Who is at this place of the screen.
  personAt(x, y) {
    const near = this.hits.map((hit) => ({ ...hit, far: Math.hypot(hit.x - x, hit.y - y) }));
    near.sort((a, b) => a.far - b.far);
    return near[0]?.far < 1.6 * this.em ? near[0].id : null;
  }
}

// An id short enough to stand beside a person: hashes by their last digits.
function shorten(id) {
  return id.length > 6 ? `…${id.slice(-4)}` : id;
}
