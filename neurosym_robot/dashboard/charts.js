// Two small charts as SVG: error by horizon, latency over time.

function svg(name, attributes, text) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

// Mean displacement error, metres, against the seconds ahead; curves: [{name, look, values}].
function drawHorizon(element, curves, period) {
  const [width, height] = [element.clientWidth, element.clientHeight];
  const em = parseFloat(getComputedStyle(document.documentElement).fontSize);
  const [left, right, top, bottom] = [2.6 * em, width - 0.9 * em, 0.5 * em, height - 1.2 * em];
  const steps = Math.max(...curves.map(({ values }) => values.length), 1);
  const highest = roundUp(Math.max(...curves.flatMap(({ values }) => values), 0.01));
  const x = (step) => left + (step / steps) * (right - left);
  const y = (value) => bottom - (value / highest) * (bottom - top);
  const drawn = [];
  for (const value of [0, highest / 2, highest]) {
    drawn.push(svg("line", { class: "axis", x1: left, x2: right, y1: y(value), y2: y(value) }));
    const place = { x: left - 0.4 * em, y: y(value), "text-anchor": "end", "dominant-baseline": "middle" };
    drawn.push(svg("text", place, `${+value.toPrecision(2)}${value === highest ? " m" : ""}`));
  }
  for (let step = 0; step <= steps; step += Math.ceil(steps / 4)) {
    const place = { x: x(step), y: bottom + 0.95 * em, "text-anchor": "middle" };
    drawn.push(svg("text", place, `${+(step * period).toFixed(1)}${step === steps ? " s" : ""}`));
  }
  for (const { look, values } of curves) {
    const d = values.map((value, n) => `${n ? "L" : "M"}${x(n + 1)} ${y(value)}`).join("");
    const path = svg("path", { d, "stroke-width": 0.14 * em, "stroke-linecap": "round" });
    path.style.stroke = `var(--model-${look})`;
    path.style.strokeDasharray = DASHES[look].map((length) => 0.14 * em * length).join(" ");
    drawn.push(path);
  }
  const said = curves.map(({ name, values }) => `${name} ${values.at(-1).toFixed(2)} m`).join(", ");
  element.setAttribute("aria-label", `Mean error after ${(steps * period).toFixed(1)} s: ${said}`);
  element.replaceChildren(...drawn);
}

// The newest latencies in milliseconds as bars, the last one at the right.
function drawLatencies(element, values) {
  const [width, height] = [element.clientWidth, element.clientHeight];
  const highest = roundUp(Math.max(...values, 1));
  const room = width / 60;
  const bars = values.slice(-60).map((value, n, all) => {
    const high = Math.max(1, (value / highest) * height);
    const x = width - (all.length - n) * room;
    const bar = svg("rect", { x, y: height - high, width: room * 0.7, height: high });
    bar.style.fill = n === all.length - 1 ? "var(--ink)" : "var(--quiet)";
    return bar;
  });
  element.setAttribute("aria-label", `Latencies of the last ${bars.length} forecasts, up to ${highest} ms`);
  element.replaceChildren(...bars);
}
