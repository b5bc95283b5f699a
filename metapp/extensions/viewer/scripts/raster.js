// Rasters, the pictures of the page: display values, and the numbers behind them.

// A raster: display values as a canvas, and the numbers behind them.
class Raster {
  constructor(width, height, source) { Object.assign(this, { width, height, source, levels: [] }); }

  static async of(name, fit) {
    if (!(name in fit.arrays)) {
      const image = await imageOf(fit.pictures[name]), made = new Raster(image.width, image.height, fit.pictures[name]);
      made.levels = [image];
      return made;
    }
    const array = await numbersOf(fit.arrays[name]), { shape } = array, values = floatsOf(array);
    const made = new Raster(shape[1], shape[0], fit.arrays[name].data);
    return Object.assign(made, { radiance: values, channels: shape[2], mean: Math.max(values.reduce((sum, x) => sum + x, 0) / values.length, 1e-20) });
  }

  // Return the region [x, y, width, height] in texels, enlarged to the size of the raster.
  part([x, y, width, height]) {
    const made = new Raster(width, height, `${this.source} ${[x, y, width, height]}`), { channels, mean } = this;
    const radiance = new Float32Array(width * height * channels);
    for (let row = 0; row < height; row++) {
      const from = ((y + row) * this.width + x) * channels;
      radiance.set(this.radiance.subarray(from, from + width * channels), row * width * channels);
    }
    return Object.assign(made, { radiance, channels, mean, times: this.width / width });
  }

  // Tone-map radiance over a mean at an exposure: x / (1 + x), encoded as sRGB.
  exposed(scale) {
    if (!this.radiance || this.scale === scale) return;
    this.scale = scale;
    this.paint((i, c) => {
      const x = Math.max(this.radiance[i * this.channels + Math.min(c, this.channels - 1)] * scale, 0), y = x / (1 + x);
      return 255 * (y <= 0.0031308 ? 12.92 * y : 1.055 * y ** (1 / 2.4) - 0.055);
    });
  }

  // Fill the canvas with value(texel, channel) in [0, 255].
  paint(value) {
    const canvas = make("canvas", { width: this.width, height: this.height }), g = canvas.getContext("2d"), data = g.createImageData(this.width, this.height);
    for (let i = 0; i < this.width * this.height; i++) {
      for (let c = 0; c < 3; c++) data.data[4 * i + c] = value(i, c);
      data.data[4 * i + 3] = 255;
    }
    g.putImageData(data, 0, 0);
    this.levels = [canvas];
    this.bytes = data.data;
  }

  // Return display values, RGBA of 8 bits.
  get data() {
    if (!this.bytes) {
      const g = make("canvas", { width: this.width, height: this.height }).getContext("2d");
      g.drawImage(this.levels[0], 0, 0);
      this.bytes = g.getImageData(0, 0, this.width, this.height).data;
    }
    return this.bytes;
  }

  // Return the canvas halved so many times: a browser that draws a canvas much smaller skips texels.
  level(n) {
    while (this.levels.length <= n) {
      const last = this.levels.at(-1), half = make("canvas", { width: Math.ceil(last.width / 2), height: Math.ceil(last.height / 2) });
      half.getContext("2d").drawImage(last, 0, 0, half.width, half.height);
      this.levels.push(half);
    }
    return this.levels[n];
  }

  // Return the text of the numbers at a texel.
  told(x, y) {
    const i = y * this.width + x;
    if (this.says) return this.says(i);
    if (this.radiance) return `radiance ${[...this.radiance.subarray(i * this.channels, (i + 1) * this.channels)].map((v) => v.toPrecision(3)).join(", ")}`;
    return `${[...this.data.subarray(4 * i, 4 * i + 3)].join(", ")} of 255`;
  }
}

// Draw curves with logarithmic axes: {x, y: titles of the axes, lines: [{label, points: [[x, y], ...]}], level: {label, y}}.
const CURVES = ["#f2a541", "#7fb2ff", "#7fd18b", "#e07bd0"];
class Chart {
  constructor(chart) { Object.assign(this, { chart, source: JSON.stringify(chart), width: 1, height: 1 }); }
  exposed() {}

  draw(g, { x, y, width, height }) {
    const { lines, level, x: across, y: up } = this.chart, r = devicePixelRatio, points = lines.flatMap((line) => line.points);
    const range = (values) => { const low = Math.min(...values), high = Math.max(...values); return [low / 1.15, high * 1.15]; };
    const [[x0, x1], [y0, y1]] = [range(points.map((p) => p[0])), range([...points.map((p) => p[1]), ...(level ? [level.y] : [])])];
    const small = width < 170 * r, left = x + (small ? 30 : 40) * r, right = x + width - 8 * r, top = y + (8 + 14 * lines.length) * r, base = y + height - 32 * r;
    const at = ([a, b]) => [left + (right - left) * Math.log(a / x0) / Math.log(x1 / x0), base - (base - top) * Math.log(b / y0) / Math.log(y1 / y0)];
    g.save();
    g.beginPath(); g.rect(x, y, width, height); g.clip();
    Object.assign(g, { fillStyle: "#101114", strokeStyle: "#3a3d44", lineWidth: r, font: `${10 * r}px system-ui, sans-serif`, textBaseline: "middle" });
    g.fillRect(x, y, width, height);
    const line = (from, to) => { g.beginPath(); g.moveTo(...from); g.lineTo(...to); g.stroke(); };
    for (const value of ticksOf(x0, x1)) { line(at([value, y0]), at([value, y1])); text(g, `${value}`, at([value, y0])[0], base + 9 * r, "center"); }
    for (const value of ticksOf(y0, y1)) { line(at([x0, value]), at([x1, value])); text(g, `${value}`, left - 4 * r, at([x0, value])[1], "right"); }
    text(g, across, (left + right) / 2, base + 22 * r, "center", right - left);
    g.setLineDash([4 * r, 3 * r]);
    if (level) { g.strokeStyle = "#e6e7e9"; line(at([x0, level.y]), at([x1, level.y])); if (!small) text(g, level.label, right - 2 * r, at([x1, level.y])[1] - 7 * r, "right", right - left); }
    lines.forEach(({ label, points: several }, i) => {
      Object.assign(g, { strokeStyle: CURVES[i % CURVES.length], fillStyle: CURVES[i % CURVES.length], lineWidth: 2 * r });
      g.setLineDash(i % 2 ? [] : [6 * r, 3 * r]);
      g.beginPath(); several.forEach((point) => g.lineTo(...at(point))); g.stroke();
      line([x + 8 * r, y + (12 + 14 * i) * r], [x + 30 * r, y + (12 + 14 * i) * r]);
      for (const point of several) { const [a, b] = at(point); g.fillRect(a - 2.5 * r, b - 2.5 * r, 5 * r, 5 * r); }
      text(g, `${label}: ${up}`, x + 35 * r, y + (12 + 14 * i) * r, "left", width - 40 * r);
    });
    g.restore();
  }
}

function text(g, what, x, y, align, most) {
  Object.assign(g, { fillStyle: "#c9ccd2", textAlign: align });
  g.fillText(what, x, y, most);
}

// Return 1, 2 and 5 times powers of ten within a range, and numbers between them if the range is small.
function ticksOf(low, high) {
  const all = [];
  for (let decade = Math.floor(Math.log10(low)); decade <= Math.log10(high); decade++) for (const k of high < 4 * low ? [1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8] : [1, 2, 5]) all.push(parseFloat((k * 10 ** decade).toPrecision(2)));
  return all.filter((each) => each >= low && each <= high);
}
