// The scene from above on a canvas: the floor, people, where they were, and where they may go.

// Dashes say which model it is, too. Lengths are in widths of the line.
const DASHES = [[0.1, 1.9], [5, 2, 0.1, 2], [4, 2], [8, 2, 2, 2]];

const SURE = 8; // people of whom a flow is sure
const [CROWD, NEAREST] = [12, 8]; // people drawn in full, and those of them for being near

// Which colour and dashes a model has: NeuroSyM and SGAN always theirs.
function looks(models) {
  const taken = new Map();
  for (const name of models) {
    const wanted = /neurosym/i.test(name) ? 0 : /sgan/i.test(name) ? 1 : 2;
    taken.set(name, [wanted, 2, 3, 1, 0].find((n) => ![...taken.values()].includes(n)) ?? 3);
  }
  return taken;
}

class Stage {
  constructor(canvas, recording) {
    Object.assign(this, { canvas, recording, style: looks(recording.models), hits: [] });
    this.back = document.createElement("canvas"); // all that changes with a forecast or the view
    this.fits = true; // to everybody, until it is moved by hand
    this.bounds = null;
    [this.x, this.y, this.span] = [0, 0, 10]; // centre and shorter side, metres
    if (recording.map) {
      this.floor = new Image();
      this.floor.onload = () => { this.drawn = null; };
      this.floor.src = recording.map.image;
    }
    this.readColours();
  }

  readColours() {
    const probe = document.body.appendChild(document.createElement("i"));
    this.colour = {};
    for (const name of ["ink", "quiet", "grid", "floor", "truth", "chosen", "learned",
      "model-0", "model-1", "model-2", "model-3"]) {
      probe.style.color = `var(--${name})`;
      this.colour[name] = getComputedStyle(probe).color;
    }
    probe.remove();
    this.drawn = null;
  }

  // See to it that these places can be seen while nobody moves the view by hand.
  include(places) {
    for (const [x, y] of places) {
      const b = this.bounds ??= { left: x, right: x, bottom: y, top: y };
      [b.left, b.right] = [Math.min(b.left, x), Math.max(b.right, x)];
      [b.bottom, b.top] = [Math.min(b.bottom, y), Math.max(b.top, y)];
    }
  }

  measure() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const density = window.devicePixelRatio || 1;
    Object.assign(this, { width, height, em: parseFloat(getComputedStyle(document.body).fontSize) });
    const side = Math.min(width, height);
    if (this.fits && this.bounds) {
      const { left, right, bottom, top } = this.bounds;
      [this.x, this.y] = [(left + right) / 2, (bottom + top) / 2];
      const [wide, high] = [Math.max(right - left, 3) + 2, Math.max(top - bottom, 3) + 2];
      this.span = side * Math.max(wide / width, high / height);
    }
    this.scale = side / this.span;
    // What is drawn of a person is as wide as a body, within bounds that can be seen.
    this.mark = Math.min(this.em, Math.max(this.em / 2, 0.6 * this.scale));
    for (const each of [this.canvas, this.back]) {
      const [w, h] = [Math.round(width * density), Math.round(height * density)];
      if (each.width !== w || each.height !== h) {
        [each.width, each.height] = [w, h];
        this.drawn = null;
      }
    }
    this.density = density;
  }

  // Closer by a factor, about a point of the screen that stays where it is.
  zoom(factor, x = this.width / 2, y = this.height / 2) {
    const [a, b] = this.toWorld(x, y);
    this.fits = false;
    this.span = Math.min(Math.max(this.span / factor, 0.5), 1e5);
    this.measure();
    const [c, d] = this.toWorld(x, y);
    [this.x, this.y] = [this.x + a - c, this.y + b - d];
  }

  move(dx, dy) {
    this.fits = false;
    [this.x, this.y] = [this.x - dx / this.scale, this.y + dy / this.scale];
  }

  toScreen([x, y]) {
    return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];
  }

  toWorld(x, y) {
    return [this.x + (x - this.width / 2) / this.scale, this.y - (y - this.height / 2) / this.scale];
  }

  // what: a moment of the recording, `shown` layers (a set), `chosen` ids, whether what happened
  // later is known
  draw(what) {
    this.measure();
    const { moment, shown } = what;
    const view = [this.x, this.y, this.scale, [...shown], what.past];
    const robot = moment?.latest?.ids.length > CROWD ? moment.robot : null;
    const key = JSON.stringify([moment?.latest?.t, moment?.flows?.t, what.past && this.recording.length, view, robot]);
    if (key !== this.drawn) {
      this.drawn = key;
      this.begin(this.back);
      this.drawFloor(shown);
      if (moment?.flows && shown.has("learned")) this.drawFlows(moment.flows.rows);
      if (moment?.latest) this.drawForecast(moment.latest, what);
    }
    this.begin(this.canvas);
    this.pen.drawImage(this.back, 0, 0, this.width, this.height);
    if (moment) this.drawPeople(what);
  }

  begin(canvas) {
    this.pen = canvas.getContext("2d");
    this.pen.setTransform(this.density, 0, 0, this.density, 0, 0);
    this.pen.clearRect(0, 0, this.width, this.height);
    Object.assign(this.pen, { lineCap: "round", lineJoin: "round" });
  }

  trace(points) {
    points.forEach((point, n) => this.pen[n ? "lineTo" : "moveTo"](...this.toScreen(point)));
  }

  stroke(points) {
    this.pen.beginPath();
    this.trace(points);
    this.pen.stroke();
  }

  // From these places on, in whole centimetres from each.
  strokeWays(starts, ways) {
    const { pen } = this;
    const scale = this.scale / 100;
    pen.beginPath();
    ways.forEach((flat, n) => {
      const [x, y] = this.toScreen(starts[n]);
      pen.moveTo(x, y);
      for (let t = 0; t < flat.length; t += 2) pen.lineTo(x + scale * flat[t], y - scale * flat[t + 1]);
    });
    pen.stroke();
  }

  dots(places, radius) {
    this.pen.beginPath();
    for (const [x, y] of places.map((place) => this.toScreen(place))) {
      this.pen.moveTo(x + radius, y);
      this.pen.arc(x, y, radius, 0, 7);
    }
    this.pen.fill();
  }

  drawFloor(shown) {
    const { pen, em } = this;
    const size = [1, 2, 5, 10, 20, 50, 100, 1e3, 1e4].find((m) => m * this.scale > 3 * em) ?? 1e5;
    const [left, top] = this.toWorld(0, 0);
    const [right, bottom] = this.toWorld(this.width, this.height);
    Object.assign(pen, { strokeStyle: this.colour.grid, lineWidth: 1 });
    for (let x = Math.ceil(left / size) * size; x <= right; x += size) this.stroke([[x, top], [x, bottom]]);
    for (let y = Math.ceil(bottom / size) * size; y <= top; y += size) this.stroke([[left, y], [right, y]]);
    const { map } = this.recording;
    if (map && shown.has("map") && this.floor.complete) {
      pen.save();
      pen.translate(...this.toScreen(map.origin));
      pen.rotate(-map.origin[2]);
      if (/rgb\(2/.test(this.colour.ink)) pen.filter = "invert(0.8)"; // light ink: in the dark
      const [w, h] = [map.width * this.scale, map.height * this.scale];
      pen.drawImage(this.floor, 0, -h, w, h);
      pen.restore();
    }
    const [x, y] = [this.width - em, this.height - em];
    Object.assign(pen, { strokeStyle: this.colour.quiet, fillStyle: this.colour.quiet, lineWidth: 1.5 });
    pen.strokeRect(x - size * this.scale, y, size * this.scale, 0);
    Object.assign(pen, { font: `${0.85 * em}px system-ui`, textAlign: "right", textBaseline: "bottom" });
    pen.fillText(`${size} m`, x, y - 3);
  }

  // Where people went from each square metre: the more of them, the darker; who stayed, as a dot.
  drawFlows(rows) {
    const { pen } = this;
    Object.assign(pen, { strokeStyle: this.colour.learned, fillStyle: this.colour.learned });
    for (const [x, y, dx, dy, share, people] of rows) {
      const far = Math.hypot(dx, dy);
      pen.globalAlpha = 0.15 + 0.75 * share * Math.min(people / SURE, 1);
      if (far < 0.5) {
        this.dots([[x, y]], 0.1 * this.scale);
        continue;
      }
      const [ux, uy] = [dx / far, dy / far];
      const length = Math.min(0.25 * far, 0.8);
      const tip = [x + length * ux, y + length * uy];
      const barb = (side) => [tip[0] - 0.2 * (ux - side * uy), tip[1] - 0.2 * (uy + side * ux)];
      pen.lineWidth = Math.max(1, 0.06 * this.scale);
      this.stroke([[x, y], tip]);
      this.stroke([barb(1), tip, barb(-1)]);
    }
    pen.globalAlpha = 1;
  }

  // Rows of the forecasts that are drawn in full: in a crowd, the nearest and the most uncertain.
  prominent({ ids, seen, models }, robot) {
    const rows = ids.map((_, n) => n);
    if (rows.length <= CROWD) return rows;
    const [x, y] = robot ?? [this.x, this.y];
    const { samples } = Object.values(models)[0];
    const far = rows.map((n) => Math.hypot(seen[n].at(-2) - x, seen[n].at(-1) - y));
    const wide = rows.map((n) => [-2, -1].reduce((sum, c) => {
      const ends = samples[n].map((flat) => flat.at(c));
      return sum + Math.max(...ends) - Math.min(...ends);
    }, 0));
    const near = rows.toSorted((a, b) => far[a] - far[b]).slice(0, NEAREST);
    const uncertain = rows.toSorted((a, b) => wide[b] - wide[a]).slice(0, CROWD - NEAREST);
    return [...new Set([...near, ...uncertain])];
  }

  drawForecast(step, { moment, shown, past }) {
    const { pen, mark } = this;
    const last = step.seen.map((flat) => flat.slice(-2));
    const full = this.prominent(step, moment.robot);
    const faint = last.map((_, n) => n).filter((n) => !full.includes(n));
    if (past && shown.has("what happened")) {
      Object.assign(pen, { strokeStyle: this.colour.truth, lineWidth: 0.6 * mark, globalAlpha: 0.4 });
      this.recording.truth(step).forEach((path) => this.stroke(path));
    }
    for (const [name, { samples, central }] of Object.entries(step.models)) {
      if (!shown.has(name) || !samples.length) continue;
      const look = this.style.get(name);
      const colour = this.colour[`model-${look}`];
      Object.assign(pen, { strokeStyle: colour, fillStyle: colour, lineWidth: 0.075 * mark });
      pen.globalAlpha = Math.min(0.9, 5 / samples[0].length);
      const starts = full.map((n) => last[n]);
      samples[0].forEach((_, k) => this.strokeWays(starts, full.map((n) => samples[n][k])));
      pen.globalAlpha = 0.35;
      this.strokeWays(faint.map((n) => last[n]), faint.map((n) => samples[n][central]));
      Object.assign(pen, { globalAlpha: 1, lineWidth: 0.2 * mark });
      pen.setLineDash(DASHES[look].map((length) => length * pen.lineWidth));
      const ways = full.map((n) => samples[n][central]);
      this.strokeWays(starts, ways);
      pen.setLineDash([]);
      this.dots(starts.map(([x, y], n) => [x + ways[n].at(-2) / 100, y + ways[n].at(-1) / 100]), 0.24 * mark);
      this.drawRegions(full.map((n) => [last[n], step.models[name].regions[n].at(-1)]));
    }
    pen.globalAlpha = 1;
    if (!shown.has("observed")) return;
    Object.assign(pen, { strokeStyle: this.colour.ink, lineWidth: 0.1 * mark });
    const [seen, extrapolated] = [[], []];
    full.map((n) => [step.seen[n], n]).forEach(([flat, n]) => {
      const points = Array.from({ length: flat.length / 2 }, (_, t) => [flat[2 * t], flat[2 * t + 1]]);
      this.stroke(points);
      const known = points.length - step.extrapolated[n];
      const first = points.length - 1 - Math.floor(step.since[n] / this.recording.period + 1e-3);
      seen.push(...points.slice(first, known));
      extrapolated.push(...points.slice(0, first), ...points.slice(known));
    });
    pen.fillStyle = this.colour.ink;
    this.dots(seen, 0.14 * mark);
    pen.fillStyle = this.colour.floor; // What was extrapolated is hollow.
    this.dots(extrapolated, 0.14 * mark);
    pen.stroke();
  }

  // Outlines of the 50 and 90 % regions: where each person will be at the last step.
  drawRegions(regions) {
    const { pen, mark } = this;
    pen.lineWidth = 0.06 * mark;
    pen.globalAlpha = 0.6;
    for (const [[x, y], [dx, dy, long, short, angle, ...radii]] of regions) {
      const middle = this.toScreen([x + dx / 100, y + dy / 100]);
      for (const radius of radii) {
        const size = (radius * this.scale) / 100;
        pen.beginPath();
        pen.ellipse(...middle, long * size, short * size, -angle, 0, 7);
        pen.stroke();
      }
    }
    pen.globalAlpha = 1;
  }

  // An arrow that says where the robot looks.
  drawRobot([x, y, yaw]) {
    const { pen } = this;
    pen.save();
    pen.translate(...this.toScreen([x, y]));
    pen.rotate(-yaw);
    pen.scale(this.em, this.em);
    pen.beginPath();
    [[-0.7, -0.7], [0.4, -0.7], [1.2, 0], [0.4, 0.7], [-0.7, 0.7]].forEach((at) => pen.lineTo(...at));
    pen.closePath();
    Object.assign(pen, { fillStyle: this.colour.chosen, strokeStyle: this.colour.floor, lineWidth: 0.14 });
    pen.fill();
    pen.stroke();
    pen.restore();
  }

  drawPeople({ moment, shown, chosen }) {
    const { pen, em, mark } = this;
    const middle = moment.robot ?? this.toWorld(this.width / 2, this.height / 2);
    const people = [...moment.at].map(([id, place]) => {
      const [x, y] = this.toScreen(place);
      const far = Math.hypot(place[0] - middle[0], place[1] - middle[1]);
      return { id, x, y, known: moment.latest?.row.has(id), mine: chosen.includes(id), far };
    });
    this.hits = people;
    for (const { x, y, known, mine } of people) {
      pen.beginPath();
      pen.arc(x, y, 0.42 * mark, 0, 7);
      pen.lineWidth = 0.14 * mark;
      pen.fillStyle = known ? this.colour.ink : this.colour.floor;
      pen.strokeStyle = known ? this.colour.floor : this.colour.quiet;
      pen.fill();
      pen.stroke();
      if (!mine) continue;
      pen.beginPath();
      pen.arc(x, y, 0.85 * mark, 0, 7);
      pen.strokeStyle = this.colour.chosen;
      pen.stroke();
    }
    if (moment.robot) this.drawRobot(moment.robot); // over the crowd, below the labels
    // A label has its place or is left out: first those chosen, then those nearest to the robot.
    const taken = people.map(({ x, y }) => [x - 0.4 * mark, y - 0.4 * mark, x + 0.4 * mark, y + 0.4 * mark]);
    people.sort((a, b) => b.mine - a.mine || a.far - b.far);
    pen.font = `600 ${0.9 * em}px system-ui, sans-serif`;
    Object.assign(pen, { textAlign: "left", textBaseline: "bottom", lineWidth: 0.25 * em });
    for (const { id, x, y, known, mine } of shown.has("ids") ? people : []) {
      const text = id.length > 8 ? `…${id.slice(-5)}` : id; // in full beside the map
      const [left, bottom] = [x + 0.45 * mark, y - 0.45 * mark];
      const box = [left, bottom - em, left + pen.measureText(text).width, bottom];
      if (!mine && taken.some((o) => box[0] < o[2] && box[2] > o[0] && box[1] < o[3] && box[3] > o[1])) continue;
      taken.push(box);
      pen.strokeStyle = this.colour.floor;
      pen.fillStyle = mine ? this.colour.chosen : known ? this.colour.ink : this.colour.quiet;
      pen.strokeText(text, left, bottom);
      pen.fillText(text, left, bottom);
    }
  }

  // Who is at this place of the screen.
  personAt(x, y) {
    const far = (hit) => Math.hypot(hit.x - x, hit.y - y);
    const near = this.hits.toSorted((a, b) => far(a) - far(b))[0];
    return near && far(near) < 1.6 * this.em ? near.id : null;
  }
}
