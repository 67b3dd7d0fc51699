// What happened, moment by moment: everything that was received, or as much of it as may be kept.

class Recording {
  constructor(introduction, limit = Infinity) {
    Object.assign(this, introduction); // title, period, observed, models, weighting, place, map, likely
    Object.assign(this, { limit, size: 0, moments: [], first: new Map() });
  }

  get length() { return this.moments.length; }

  // Take in a line; the number of moments that were let go for it.
  add(line) {
    const moment = JSON.parse(line);
    const before = this.moments.at(-1);
    if (moment.t === undefined) { // the ending
      if (before) before.score = moment.score;
      return 0;
    }
    moment.size = line.length;
    moment.at = new Map(moment.ids.map((id, n) => [id, [moment.xy[2 * n], moment.xy[2 * n + 1]]]));
    for (const id of moment.ids) if (!this.first.has(id)) this.first.set(id, moment.t);
    if (moment.step) moment.step.row = new Map(moment.step.ids.map((id, n) => [id, n]));
    // The newest forecast is shown, unless there was none for a while.
    moment.latest = moment.step ?? before?.latest ?? null;
    if (moment.latest && moment.t - moment.latest.t > 1.5 * this.period) moment.latest = null;
    if (moment.flows) moment.flows = { rows: moment.flows, t: moment.t };
    moment.flows ??= before?.flows ?? null;
    moment.score = moment.step?.score ?? before?.score ?? null;
    this.moments.push(moment);
    this.size += moment.size;
    let gone = 0;
    while (this.size > this.limit && gone < this.length - 1) this.size -= this.moments[gone++].size;
    this.moments.splice(0, gone);
    return gone;
  }

  // Index of the newest moment at time t or before.
  indexAt(t) {
    let [low, high] = [0, this.length - 1];
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.moments[middle].t <= t) low = middle; else high = middle - 1;
    }
    return low;
  }

  // Where people of a forecast really went within its horizon, by id: as far as it is known.
  truth(step) {
    const steps = Object.values(step.models)[0].samples[0][0].length / 2;
    const paths = step.ids.map((id, n) => [id, [step.seen[n].slice(-2)]]);
    for (let n = this.indexAt(step.t); n < this.length; n += 1) {
      if (this.moments[n].t > step.t + steps * this.period) break;
      for (const [id, path] of paths) if (this.moments[n].at.has(id)) path.push(this.moments[n].at.get(id));
    }
    return paths.map(([, path]) => path);
  }

  // Where people of a forecast are, and where the first model's most probable path takes them.
  ends(step) {
    const { samples, central } = step.models[this.models[0]];
    return step.seen.flatMap((flat, n) => {
      const [x, y] = flat.slice(-2);
      const [dx, dy] = samples[n][central].slice(-2);
      return [[x, y], [x + dx / 100, y + dy / 100]];
    });
  }

  // The robot's velocity at a moment, m/s, over the second before.
  velocity(index) {
    const now = this.moments[index];
    const then = this.moments[this.indexAt(now.t - 1)];
    const seconds = now.t - then.t;
    if (!then.robot || seconds <= 0) return [0, 0];
    return [0, 1].map((n) => (now.robot[n] - then.robot[n]) / seconds);
  }

  // The people of the forecast who come nearest, if the robot keeps its velocity: so many.
  approaches(index, most) {
    const { latest: step, robot, at } = this.moments[index];
    if (!step || !robot) return [];
    const speed = this.velocity(index);
    const { samples, central, weights } = step.models[this.models[0]];
    const found = step.ids.filter((id) => at.has(id)).map((id) => {
      const n = step.row.get(id);
      const [x, y] = step.seen[n].slice(-2);
      const least = (flat) => {
        let best = [Math.hypot(x - robot[0], y - robot[1]), 0];
        let from = [x - robot[0], y - robot[1]];
        for (let t = 0; t < flat.length / 2; t += 1) {
          const ahead = (t + 1) * this.period;
          const to = [x + flat[2 * t] / 100 - robot[0] - speed[0] * ahead,
            y + flat[2 * t + 1] / 100 - robot[1] - speed[1] * ahead];
          const way = [to[0] - from[0], to[1] - from[1]];
          const length = way[0] ** 2 + way[1] ** 2;
          const share = length && Math.min(1, Math.max(0, -(from[0] * way[0] + from[1] * way[1]) / length));
          const apart = Math.hypot(from[0] + share * way[0], from[1] + share * way[1]);
          if (apart < best[0]) best = [apart, (t + share) * this.period];
          from = to;
        }
        return best;
      };
      const near = () => samples[n].reduce((sum, flat, k) => sum + (least(flat)[0] < 1 && weights[k]), 0);
      const [closest, seconds] = least(samples[n][central]);
      const place = at.get(id);
      return { id, now: Math.hypot(place[0] - robot[0], place[1] - robot[1]), closest, seconds, near };
    });
    return found.sort((a, b) => a.closest - b.closest).slice(0, most);
  }

  // Symbols q1 .. q4 of k and l in a forecast, the weight that l has for k, and metres apart.
  pair(step, k, l) {
    const [i, j] = [step?.row.get(k), step?.row.get(l)];
    if (!step?.codes || i === undefined || j === undefined || i === j) return null;
    const [low, high] = [Math.min(i, j), Math.max(i, j)];
    const people = step.ids.length;
    const code = step.codes[low * people - (low * (low + 1)) / 2 + high - low - 1];
    let symbols = [27, 9, 3, 1].map((place) => (Math.floor(code / place) % 3) - 1);
    if (i > j) symbols = [symbols[1], symbols[0], symbols[3], symbols[2]]; // the converse
    const [a, b] = [step.seen[i].slice(-2), step.seen[j].slice(-2)];
    const alpha = step.alpha && step.alpha[i * people + j];
    return { symbols, alpha, distance: Math.hypot(a[0] - b[0], a[1] - b[1]) };
  }
}
