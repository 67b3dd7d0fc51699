// Which layers are drawn: a list that is the legend, too.

class Layers {
  constructor(recording, style, changed) {
    this.style = style;
    this.shown = new Set();
    const layers = [["observed", "observed"], ["truth", "what happened"],
      ...recording.models.map((name) => [`model ${name}`, name]), ["pair", "pair"]];
    if (recording.map) layers.push(["map", "map"]);
    find("layers").open = matchMedia("(min-width: 861px)").matches; // folded on a phone
    find("layers").append(...layers.map(([layer, text]) => {
      this.shown.add(layer);
      const label = make("label");
      const box = make("input", "", { type: "checkbox", checked: true });
      box.onchange = () => {
        this.shown[box.checked ? "add" : "delete"](layer);
        changed();
      };
      label.append(box, make("canvas"), text);
      label.dataset.layer = layer;
      return label;
    }));
  }

  // The n-th, from 0, on or off.
  toggle(n) {
    find("layers").querySelectorAll("input")[n]?.click();
  }

  // How each looks, beside its name.
  drawSamples(colour) {
    for (const label of find("layers").querySelectorAll("label")) {
      this.drawSample(label.querySelector("canvas"), label.dataset.layer, colour);
    }
  }

  drawSample(canvas, layer, colour) {
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const density = window.devicePixelRatio || 1;
    Object.assign(canvas, { width: width * density, height: height * density });
    const pen = canvas.getContext("2d");
    pen.scale(density * height, density * height); // lengths in heights from here
    const [from, to] = [0.3, width / height - 0.3];
    const look = this.style.get(layer.replace("model ", ""));
    const kinds = {
      observed: { ink: "ink", lineWidth: 0.1 },
      truth: { ink: "truth", lineWidth: 0.55, globalAlpha: 0.4 },
      pair: { ink: "pair", lineWidth: 0.12, dashes: [0.35, 0.3] },
      map: { ink: "wall", lineWidth: 0.8, lineCap: "butt", globalAlpha: 0.75 },
    };
    const model = { ink: `model-${look}`, lineWidth: 0.2, dashes: DASHES[look]?.map((n) => 0.2 * n) };
    const { ink, dashes = [], ...rest } = kinds[layer] ?? model;
    Object.assign(pen, { lineCap: "round", ...rest, strokeStyle: colour[ink], fillStyle: colour[ink] });
    pen.setLineDash(dashes);
    pen.beginPath();
    pen.moveTo(from, 0.5);
    pen.lineTo(to, 0.5);
    pen.stroke();
    for (let n = 0; layer === "observed" && n < 4; n += 1) {
      pen.beginPath();
      pen.arc(from + (n / 3) * (to - from), 0.5, 0.14, 0, 7);
      pen.fill();
    }
  }
}
