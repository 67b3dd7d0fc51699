// What happened, moment by moment: everything that was received, or as much of it as may be kept.

class Recording {
  constructor(introduction, limit = Infinity) {
    Object.assign(this, introduction); // title, period, models, weighting, map, speed, likely
    this.limit = limit; // characters of JSON
    this.size = 0;
    this.moments = [];
    this.steps = [];
  }

  get length() { return this.moments.length; }

  // Take in a line; the number of moments that were let go for it.
  add(line) {
    const moment = JSON.parse(line);
    if (moment.t === undefined) { // the ending
      if (this.length) this.moments.at(-1).score = moment.score;
      return 0;
    }
    const before = this.moments.at(-1);
    moment.size = line.length;
    moment.at = new Map(moment.ids.map((id, n) => [id, [moment.xy[2 * n], moment.xy[2 * n + 1]]]));
    if (moment.step) {
      this.steps.push(moment.step);
      moment.step.row = new Map(moment.step.ids.map((id, n) => [id, n]));
    }
    // What is on the screen then: the newest forecast, unless there was none for a while.
    moment.latest = moment.step ?? before?.latest ?? null;
    if (moment.latest && moment.t - moment.latest.t > 1.5 * this.period + 0.01) moment.latest = null;
    moment.score = moment.step?.score ?? before?.score ?? null;
    this.moments.push(moment);
    this.size += moment.size;
    let gone = 0;
    while (this.size > this.limit && gone < this.moments.length - 1) {
      this.size -= this.moments[gone].size;
      if (this.moments[gone].step) this.steps.shift();
      gone += 1;
    }
    if (gone) this.moments.splice(0, gone);
    return gone;
  }

  // The forecast made `age` seconds before that of a moment, or null.
  stepAt(moment, age) {
    if (!moment?.latest) return null;
    const t = moment.latest.t - age;
    const step = this.steps[after(this.steps, t + 0.01) - 1];
    return step && step.t > t - this.period ? step : null;
  }

  // Up to `count` forecasts up to this one, without a break before it; oldest first.
  stepsUntil(step, count) {
    const end = after(this.steps, step.t);
    let begin = end - 1;
    while (begin > 0 && end - begin < count
      && this.steps[begin].t - this.steps[begin - 1].t < 1.5 * this.period) begin -= 1;
    return this.steps.slice(Math.max(begin, 0), end);
  }

  // Steps that a forecast looks ahead.
  horizon(step) {
    return Math.max(...Object.values(step.models).map(({ samples }) => samples[0][0].length / 2));
  }

  // Where people of a forecast really went within its horizon, by id: as far as it is known.
  truth(step) {
    const end = step.t + this.horizon(step) * this.period + 0.01;
    const paths = new Map(step.ids.map((id, n) => [id, [step.seen[n].slice(-2)]]));
    for (let n = after(this.moments, step.t); n < this.length && this.moments[n].t <= end; n += 1) {
      for (const [id, path] of paths) {
        const place = this.moments[n].at.get(id);
        if (place) path.push(place);
      }
    }
    return paths;
  }

  // Symbols q1 .. q4 of k and l in a forecast, and the weight that l has for k.
  pair(step, k, l) {
    const [i, j] = [step.row.get(k), step.row.get(l)];
    if (i === undefined || j === undefined || i === j) return null;
    const [low, high] = [Math.min(i, j), Math.max(i, j)];
    const people = step.ids.length;
    const code = step.codes[low * people - (low * (low + 1)) / 2 + high - low - 1];
    let symbols = [27, 9, 3, 1].map((place) => (Math.floor(code / place) % 3) - 1);
    if (i > j) symbols = [symbols[1], symbols[0], symbols[3], symbols[2]]; // the converse
    const [a, b] = [step.seen[i].slice(-2), step.seen[j].slice(-2)];
    return {
      symbols,
      alpha: step.alpha && step.alpha[i * people + j],
      distance: Math.hypot(a[0] - b[0], a[1] - b[1]),
    };
  }

  // Shares of -, 0 and + of q1 .. q4 of k and l at each step ahead, as symbolic_forecast has them:
  // [q][step][-, 0, +] over the samples of the model whose events are told.
  ahead(step, k, l) {
    const { samples } = step.models[this.likely.model];
    const ways = [k, l].map((id) => {
      const n = step.row.get(id);
      const [x, y] = step.seen[n].slice(-2);
      return samples[n].map((flat) => Array.from({ length: flat.length / 2 + 1 }, (_, t) => (
        t ? [x + flat[2 * t - 2] / 100, y + flat[2 * t - 1] / 100] : [x, y])));
    });
    const still = this.speed * this.period;
    const [count, steps] = [samples[0].length, samples[0][0].length / 2];
    const shares = [0, 1, 2, 3].map(() => Array.from({ length: steps }, () => [1 / 3, 1 / 3, 1 / 3]));
    for (let s = 0; s < count; s += 1) {
      for (let t = 0; t < steps; t += 1) {
        symbols(ways[0][s].slice(t, t + 2), ways[1][s].slice(t, t + 2), still)
          .forEach((symbol, q) => { shares[q][t][symbol + 1] += 1; });
      }
    }
    return shares.map((row) => row.map((each) => each.map((seen) => seen / (count + 1))));
  }
}

// QTC_C1 of k and l over one step, up to `still` metres of which are none (symbolic/qtc.py).
function symbols(k, l, still) {
  const sign = (value, least) => (value > least) - (value < -least);
  const moves = [[k, l[0]], [l, k[0]]].map(([[[x0, y0], [x1, y1]], [x, y]]) => {
    const before = Math.hypot(x0 - x, y0 - y);
    const across = (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0);
    return [sign(Math.hypot(x1 - x, y1 - y) - before, still), sign(across, still * before)];
  });
  return [0, 1].flatMap((n) => moves.map((each) => each[n]));
}

// Index of the first of `timed` that is later than t.
function after(timed, t) {
  let [low, high] = [0, timed.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (timed[middle].t <= t) low = middle + 1; else high = middle;
  }
  return low;
}
