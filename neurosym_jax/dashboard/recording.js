// What happened, moment by moment: everything that was received, or as much of it as may be kept.

class Recording {
  constructor(introduction, limit = Infinity) {
    Object.assign(this, introduction); // title, period, models, weighting, map
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
