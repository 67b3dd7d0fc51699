// Which part of the world a canvas shows, and the way between metres and points on the screen.

class View {
  constructor(canvas) {
    this.canvas = canvas;
    this.fits = true; // to everybody, until it is moved by hand
    this.bounds = null;
    [this.x, this.y, this.span] = [0, 0, 10]; // centre and shorter side, metres
  }

  // Metres of the world that fit into the screen's shorter side, and everything that hangs on it.
  measure() {
    const { clientWidth, clientHeight } = this.canvas;
    [this.width, this.height] = [clientWidth, clientHeight];
    this.em = parseFloat(getComputedStyle(document.documentElement).fontSize);
    const side = Math.min(this.width, this.height);
    if (this.fits && this.bounds) {
      const { left, right, bottom, top } = this.bounds;
      const [wide, high] = [Math.max(right - left, 3) + 2, Math.max(top - bottom, 3) + 2];
      [this.x, this.y] = [(left + right) / 2, (bottom + top) / 2];
      this.span = side * Math.max(wide / this.width, high / this.height);
    }
    this.scale = side / this.span;
  }

  // See to it that these places can be seen while nobody moves the view by hand.
  include(places) {
    for (const [x, y] of places) {
      const b = this.bounds ??= { left: x, right: x, bottom: y, top: y };
      [b.left, b.right] = [Math.min(b.left, x), Math.max(b.right, x)];
      [b.bottom, b.top] = [Math.min(b.bottom, y), Math.max(b.top, y)];
    }
  }

  fit(places) {
    this.bounds = null;
    this.fits = true;
    this.include(places);
  }

  // Closer by a factor, about a point of the screen that stays where it is.
  zoom(factor, x = this.width / 2, y = this.height / 2) {
    const [a, b] = this.toWorld(x, y);
    this.fits = false;
    this.span = Math.min(Math.max(this.span / factor, 0.5), 1e5);
    this.measure();
    const [c, d] = this.toWorld(x, y);
    this.x += a - c;
    this.y += b - d;
  }

  move(dx, dy) {
    this.fits = false;
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
  }

  toScreen([x, y]) {
    return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];
  }

  toWorld(x, y) {
    return [this.x + (x - this.width / 2) / this.scale, this.y - (y - this.height / 2) / this.scale];
  }

  // Metres between the lines of the grid: 1, 2, 5, 10, ...
  get gridStep() {
    return roundUp((3.2 * this.em) / this.scale, [1, 2, 5, 10]);
  }
}

// A round number that is not below `value`.
function roundUp(value, digits = [1, 1.5, 2, 3, 4, 5, 6, 8, 10]) {
  const power = 10 ** Math.floor(Math.log10(value));
  return digits.map((digit) => digit * power).find((round) => round >= value * 0.999);
}
