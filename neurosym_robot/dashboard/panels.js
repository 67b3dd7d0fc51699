// The panels beside the scene: errors, the pair and its symbols, events, latency, people left out.

const GLYPHS = { "-1": "−", 0: "0", 1: "+" };
const APPROACH = { "-1": "nears", 0: "keeps from", 1: "leaves" };
const SIDE = { "-1": "to the left", 0: "on the line", 1: "to the right" };
const REASONS = {
  short: "observed too briefly",
  unseen: "not seen at the last step",
  crowded: "too many; others are nearer",
  compiling: "still compiling for so many; others are nearer",
  "future unknown": "forecasts without a known future",
};
const COLUMNS = 16; // of the chain of states, seen and ahead
const SEEN = 4; // of them, at least
const TOLD = 5; // events

const find = (id) => document.getElementById(id);

function make(name, text = "", properties = {}) {
  return Object.assign(document.createElement(name), { textContent: text }, properties);
}

// Set text only where it changes, so that nothing that is selected or read aloud is disturbed.
function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

class Panels {
  constructor(recording, style, onPair) {
    this.recording = recording;
    this.style = style;
    const { weighting } = recording;
    say(find("convention"), weighting ? `QTC_C1, weights of ${weighting.model}` : "QTC_C1");
    find("convention").title = weighting ? `weighting ${weighting.name}` : "";
    find("alpha").hidden = !weighting;
    for (const id of ["k", "l"]) {
      find(id).onchange = () => onPair([find("k").value, find("l").value]);
    }
  }

  show({ moment, step, latest, pair }) {
    this.showErrors(moment?.score);
    this.showPair(step, pair, moment);
    this.showLikely(step);
    this.showLatency(moment, latest);
    this.showDropped(moment, latest);
  }

  showErrors(score) {
    if (score === this.score) return;
    this.score = score;
    const [first] = Object.values(this.recording.steps[0]?.models ?? {});
    say(find("best-of"), first ? `best of ${first.samples[0].length}, metres` : "metres");
    const keys = ["joint_ade", "joint_fde", "marginal_ade", "marginal_fde"];
    const models = score?.models ?? {};
    const shown = (value) => value?.toFixed(2);
    const all = keys.map((key) => Object.values(models).map((each) => each[key]).filter((value) => value !== null));
    const best = all.map((values) => shown(Math.min(...values)));
    // A tie, as far as it is shown, has no best.
    const alone = (n) => all[n].length > 1 && all[n].filter((value) => shown(value) === best[n]).length === 1;
    const names = [...this.recording.models];
    names.push(...Object.keys(models).filter((name) => !names.includes(name))); // constant velocity
    const rows = names.map((name) => {
      const row = make("tr");
      const head = make("th", "", { scope: "row", title: name });
      const swatch = make("span", "", { className: "swatch" });
      const look = this.style.get(name);
      if (look === undefined) head.className = "plain";
      else head.append(swatch);
      swatch.style.background = `var(--model-${look})`;
      head.append(name);
      row.append(head);
      keys.forEach((key, n) => {
        const value = models[name]?.[key] ?? null;
        const cell = make("td", value === null ? "–" : value.toFixed(2));
        cell.dataset.key = key;
        if (value !== null && shown(value) === best[n] && alone(n)) cell.className = "best";
        row.append(cell);
      });
      row.append(make("td", String(models[name]?.people ?? 0)));
      return row;
    });
    find("errors").tBodies[0].replaceChildren(...rows);
    const curves = this.recording.models
      .map((name) => ({ name, look: this.style.get(name), values: models[name]?.horizon ?? [] }))
      .filter(({ values }) => values.length && values[0] !== null);
    find("horizon").parentElement.hidden = !curves.length;
    if (curves.length) drawHorizon(find("horizon"), curves, this.recording.period);
  }

  showPair(step, pair, moment) {
    this.offer(step, pair);
    const known = step && this.recording.pair(step, ...pair);
    const key = known ? `${step.t} ${pair} ${this.recording.steps[0].t}` : "";
    if (key === this.shownPair) return;
    this.shownPair = key;
    const [k, l] = pair.map(shorten);
    const symbols = known ? known.symbols : [null, null, null, null];
    const words = (n) => {
      const [mover, other] = n % 2 ? [l, k] : [k, l];
      return n < 2 ? `${mover} ${APPROACH[symbols[n]]} ${other}` : `${mover} ${SIDE[symbols[n]]}`;
    };
    find("symbols").replaceChildren(...symbols.map((symbol, n) => {
      const tile = make("div");
      const told = make("dd");
      told.append(make("b", symbol === null ? "·" : GLYPHS[symbol]), make("span", symbol === null ? "" : words(n)));
      tile.append(make("dt", `q${n + 1}`), told);
      return tile;
    }));
    say(find("distance"), known ? `${known.distance.toFixed(2)} m` : "");
    const [meter, output] = [find("alpha").children[1], find("alpha").children[2]];
    const alpha = known?.alpha ?? null;
    const most = alpha > 0.2 ? 1 : 0.2; // a weight of the theory's table is at most 1/9
    meter.setAttribute("aria-valuemax", most);
    meter.setAttribute("aria-valuenow", alpha ?? 0);
    meter.firstChild.style.width = `${Math.min(1, (alpha ?? 0) / most) * 100}%`;
    output.textContent = alpha === null ? "–" : alpha.toFixed(3);
    this.showChain(step, pair, known);
  }

  // What was seen of the pair, symbol by symbol, and how probable each symbol is from now on.
  showChain(step, pair, known) {
    const { period, likely } = this.recording;
    const shares = known ? this.recording.ahead(step, ...pair) : [[], [], [], []];
    const [seen, steps] = [Math.max(SEEN, COLUMNS - shares[0].length), shares[0].length];
    const chain = known
      ? this.recording.stepsUntil(step, seen).map((each) => this.recording.pair(each, ...pair)) : [];
    while (chain.length < seen) chain.unshift(null);
    find("chain").tBodies[0].replaceChildren(...[0, 1, 2, 3].map((q) => {
      const row = make("tr");
      row.append(make("th", `q${q + 1}`, { scope: "row" }));
      row.append(...chain.map((state) => make("td", state ? GLYPHS[state.symbols[q]] : "·")));
      row.lastChild.className = "now";
      row.append(...shares[q].map((each, t) => {
        const best = each.indexOf(Math.max(...each)) - 1;
        const cell = make("td", GLYPHS[best], { className: "ahead" });
        const [minus, plus] = [each[0], each[2]].map((share) => `${(100 * share).toFixed(1)}%`);
        cell.style.setProperty("--minus", minus);
        cell.style.setProperty("--plus", plus);
        const said = each.map((share, n) => `${GLYPHS[n - 1]} ${(100 * share).toFixed(0)} %`).join(", ");
        cell.title = `q${q + 1} in ${((t + 1) * period).toFixed(1)} s: ${said}`;
        return cell;
      }));
      return row;
    }));
    const [past, future] = find("chain").tHead.rows[0].querySelectorAll("th");
    past.colSpan = seen;
    future.colSpan = Math.max(1, steps);
    future.hidden = !known;
    say(future, `${likely.model}, ${(steps * period).toFixed(1)} s ahead`);
  }

  // Probable events of all pairs, in words.
  showLikely(step) {
    if (step === this.told) return;
    this.told = step;
    const { at_least: least, model, words } = this.recording.likely;
    say(find("likely-from"), `${model}, ${Math.round(100 * least)} % or more`);
    const events = step?.likely ?? [];
    const items = events.slice(0, TOLD).map(([name, k, l, share, seconds]) => {
      const person = { k: shorten(step.ids[k]), l: shorten(step.ids[l]) };
      const item = make("li", words[name].replace(/\{([kl])\}/g, (_, who) => person[who]));
      const when = `in ${seconds.toFixed(1)} s`;
      item.append(make("b", `${Math.round(100 * share)} %`), make("span", when));
      return item;
    });
    if (!items.length) items.push(make("li", step ? "nothing is that probable" : "no forecast"));
    if (events.length > TOLD) items.push(make("li", "and more"));
    find("likely").replaceChildren(...items);
  }

  // The people who can be chosen.
  offer(step, pair) {
    const ids = [...new Set([...(step?.ids ?? []), ...pair])].filter((id) => id !== "");
    const key = ids.join(" ");
    if (key !== this.offered) {
      this.offered = key;
      for (const id of ["k", "l"]) {
        find(id).replaceChildren(...ids.map((person) => make("option", shorten(person), { value: person })));
      }
    }
    ["k", "l"].forEach((id, n) => {
      if (find(id).value !== pair[n] && document.activeElement !== find(id)) find(id).value = pair[n];
    });
  }

  showLatency(moment, latest) {
    if (!latest || latest === this.timed) return;
    this.timed = latest;
    const { p50, p99 } = latest.score.latency_ms;
    find("percentiles").replaceChildren(
      make("b", `${latest.latency.toFixed(1)} ms`), ` median ${p50.toFixed(1)}, p99 ${p99.toFixed(1)}`,
    );
    const newest = this.recording.steps.slice(0, after(this.recording.steps, latest.t)).slice(-60);
    drawLatencies(find("latencies"), newest.map((step) => step.latency));
  }

  showDropped(moment, latest) {
    const reasons = Map.groupBy(Object.entries(latest?.dropped ?? {}), ([, reason]) => reason);
    const lost = latest?.ids.filter((id, n) => latest.extrapolated[n]) ?? [];
    const key = JSON.stringify([latest?.dropped, lost, moment?.more, moment?.score?.dropped]);
    if (key === this.left) return;
    this.left = key;
    const items = [];
    const list = (reason, ids) => {
      const item = make("li", `${reason}:`);
      item.append(...ids.slice(0, 12).map((id) => make("span", shorten(id), { title: id })));
      if (ids.length > 12) item.append(` and ${ids.length - 12} more`);
      items.push(item);
    };
    for (const [reason, people] of reasons) list(REASONS[reason] ?? reason, people.map(([id]) => id));
    if (moment?.more) items.push(make("li", `${moment.more} more were seen than are shown`));
    if (!items.length) items.push(make("li", "nobody"));
    if (lost.length) list("forecast though lost, from where they would be (hollow)", lost);
    find("dropped").replaceChildren(...items);
    const totals = Object.entries(moment?.score?.dropped ?? {});
    say(find("totals"), totals.length
      ? `So far: ${totals.map(([reason, count]) => `${count} ${reason}`).join(", ")}` : "");
  }
}
