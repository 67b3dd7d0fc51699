// The panels beside the scene: freshness, who comes near, who has no forecast and why, analysis.

const GLYPHS = { "-1": "−", 0: "0", 1: "+" };
const APPROACH = { "-1": "nears", 0: "keeps from", 1: "leaves" };
const SIDE = { "-1": "to the left", 0: "on the line", 1: "to the right" };
const REASONS = {
  unseen: "not seen in the newest frame",
  crowded: "too many people; others are nearer",
  compiling: "the program for so many people is being compiled",
};
const [ROWS, TOLD] = [8, 5]; // people near the robot; events

const find = (id) => document.getElementById(id);

function make(name, text = "", properties = {}) {
  return Object.assign(document.createElement(name), { textContent: text }, properties);
}

// Set text only where it changes, so that nothing that is selected or read aloud is disturbed.
function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

class Panels {
  constructor(recording, style, choose) {
    Object.assign(this, { recording, style, choose });
    const { weighting, likely, models } = recording;
    say(find("near-model"), models[0]);
    // Pairs need a model in JAX.
    for (const part of ["pair", "events"]) find(part).hidden = !likely;
    say(find("convention"), weighting ? `QTC_C1, weights of ${weighting.model}` : "QTC_C1");
    if (likely) say(find("likely-from"), `${likely.model}, ${Math.round(100 * likely.at_least)} % or more`);
    for (const id of ["k", "l"]) find(id).onchange = () => choose([find("k").value, find("l").value]);
    find("analysis").ontoggle = () => { this.analysed = null; this.show(this.shown, this.pair); };
  }

  show(index, pair) {
    const moment = this.recording.moments[index];
    [this.shown, this.pair] = [index, pair];
    if (!moment) return;
    this.showTiles(moment, null);
    this.showMissing(moment);
    this.showNear(index, moment);
    const wrong = Object.entries(moment.now.wrong).map(([name, count]) => `${name} ${count}`);
    say(find("wrong"), wrong.join(", ") || "Nothing was wrong so far.");
    say(find("place"), moment.now.place);
    say(find("reports"), moment.now.reports.join(". "));
    if (moment.latest !== this.told) this.showLikely(this.told = moment.latest);
    const key = `${moment.latest?.t} ${pair}`;
    if (find("analysis").open && key !== this.analysed) {
      this.analysed = key;
      this.showErrors(moment.score);
      this.showPair(moment.latest, pair);
    }
  }

  // `fresh` is how old people are and how many frames come a second now, while what is live is shown.
  showTiles({ now, ids, more, latest }, fresh) {
    const ms = (value) => (value === null ? "–" : value < 10 ? value.toFixed(1) : value.toFixed(0));
    const tiles = [
      ["age", `${ms(fresh ? Math.max(1000 * fresh.age, now.age) : now.age)} ms`, `From a frame's stamp to its forecast: p50 ${ms(now.p50)}, p99 ${ms(now.p99)} ms`],
      ["p99", `${ms(now.p99)} ms`, "99 % of forecasts were younger when they were published"],
      ["input", `${(fresh ?? now).rate.toFixed(1)} Hz`, "Frames a second"],
      ["skipped", String(now.skipped), "Frames without a forecast, because a newer one had come"],
      ["people", String(ids.length + more), "Seen in this frame"],
      ["forecast", String(latest?.ids.length ?? 0), "People with a forecast"],
    ];
    if (now.offset) tiles.push(["clock offset", `${now.offset.toFixed(1)} s`, "A constant part of the age: two clocks differ, or the tracker is late"]);
    const list = find("tiles");
    while (list.children.length > tiles.length) list.lastChild.remove();
    tiles.forEach(([name, value, title], n) => {
      const tile = list.children[n] ?? list.appendChild(make("div"));
      if (!tile.firstChild) tile.append(make("dt"), make("dd"));
      tile.title = title;
      say(tile.firstChild, name);
      say(tile.lastChild, value);
    });
  }

  showMissing({ t, now, at, latest, more }) {
    const why = (id, reason) => {
      if (reason !== "short") return REASONS[reason] ?? reason;
      const seen = t - this.recording.first.get(id);
      return `seen for ${seen.toFixed(1)} s: once, or for less than --min-seen`;
    };
    const groups = new Map();
    const add = (id, text) => groups.set(text, [...(groups.get(text) ?? []), id]);
    for (const [id, reason] of Object.entries(now.missing)) if (at.has(id)) add(id, why(id, reason));
    latest?.ids.forEach((id, n) => latest.extrapolated[n] && !at.has(id) && add(id, "out of sight, and forecast by the last velocity"));
    const key = JSON.stringify([...groups, more, at.size]);
    if (key === this.missing) return;
    this.missing = key;
    const items = [...groups].map(([text, ids]) => {
      const item = make("li", `${text}: `);
      ids.slice(0, 12).forEach((id) => item.append(make("span", id)));
      if (ids.length > 12) item.append(`and ${ids.length - 12} more`);
      return item;
    });
    if (more) items.push(make("li", `${more} more people are not listed`));
    if (!items.length) items.push(make("li", at.size ? `All ${at.size} people have a forecast.` : "Nobody is seen."));
    find("missing").replaceChildren(...items);
  }

  showNear(index, { robot, t }) {
    find("near").hidden = !robot;
    find("no-robot").hidden = Boolean(robot);
    if (!robot || t === this.approached) return;
    this.approached = t;
    const rows = this.recording.approaches(index, ROWS).map((each) => {
      const row = make("tr", "", { onclick: () => this.choose([each.id, this.pair[0]]) });
      row.append(make("th", each.id, { scope: "row" }), make("td", `${each.now.toFixed(1)} m`),
        make("td", `${each.closest.toFixed(1)} m`), make("td", `${each.seconds.toFixed(1)} s`),
        make("td", `${Math.round(100 * each.near())} %`));
      row.classList.toggle("soon", each.closest < 1);
      return row;
    });
    if (!rows.length) rows.push(make("tr"));
    if (!rows[0].firstChild) rows[0].append(make("td", "Nobody has a forecast.", { colSpan: 5 }));
    find("near").tBodies[0].replaceChildren(...rows);
  }

  // Probable events of all pairs, in words.
  showLikely(step) {
    const items = (step?.likely ?? []).slice(0, TOLD).map(([name, k, l, share, seconds]) => {
      const person = { k: step.ids[k], l: step.ids[l] };
      const words = this.recording.likely.words[name].replace(/\{([kl])\}/g, (_, who) => person[who]);
      const item = make("li", words);
      item.append(make("b", `${Math.round(100 * share)} %`), make("span", `in ${seconds.toFixed(1)} s`));
      return item;
    });
    if (!items.length) items.push(make("li", step ? "Nothing is that probable." : "No forecast."));
    find("likely").replaceChildren(...items);
  }

  showErrors(score) {
    const keys = ["published_ade", "published_fde", "joint_ade", "joint_fde", "runtime"];
    const held = Object.entries(score?.models ?? {}).flatMap(([name, { coverage }]) => {
      const shares = Object.entries(coverage).map(([level, share]) => `${level} % regions held ${Math.round(100 * share)} %`);
      return shares.length ? `${name}: ${shares.join(", ")} in the last 5 minutes` : [];
    });
    find("held").textContent = held.join("; ");
    const rows = Object.entries(score?.models ?? {}).map(([name, means]) => {
      const row = make("tr");
      const head = make("th", name, { scope: "row", title: `${means.people} people compared` });
      head.style.color = this.style.has(name) ? `var(--model-${this.style.get(name)})` : "";
      row.append(head, ...keys.map((key) => {
        const cell = make("td", means[key]?.toFixed(key === "runtime" ? 1 : 2) ?? "–");
        cell.dataset.key = key;
        return cell;
      }));
      return row;
    });
    if (!rows.length) rows.push(make("tr"));
    if (!rows[0].firstChild) rows[0].append(make("td", "No future is known yet.", { colSpan: 6 }));
    find("errors").tBodies[0].replaceChildren(...rows);
  }

  showPair(step, pair) {
    const ids = [...new Set([...(step?.ids ?? []), ...pair])].filter(Boolean);
    ["k", "l"].forEach((who, n) => {
      const select = find(who);
      if (document.activeElement === select && select.value === pair[n]) return;
      select.replaceChildren(...ids.map((id) => make("option", id, { value: id })));
      select.value = pair[n];
    });
    const known = this.recording.pair(step, ...pair);
    const [k, l] = pair;
    const words = (n, symbol) => {
      const [mover, other] = n % 2 ? [l, k] : [k, l];
      return n < 2 ? `${mover} ${APPROACH[symbol]} ${other}` : `${mover} ${SIDE[symbol]}`;
    };
    find("symbols").replaceChildren(...(known?.symbols ?? []).map((symbol, n) => {
      const tile = make("div");
      tile.append(make("dt", `q${n + 1}`), make("dd", GLYPHS[symbol], { title: words(n, symbol) }));
      return tile;
    }));
    say(find("distance"), known ? `${known.distance.toFixed(2)} m apart` : "");
    const said = (known?.symbols ?? []).map((symbol, n) => words(n, symbol)).join(", ");
    const { weighting } = this.recording;
    const weight = weighting && known ? `. ${weighting.name}: l counts ${known.alpha.toFixed(3)} for k` : "";
    say(find("alpha"), known ? said + weight : "Choose two people, here or on the map.");
  }
}
