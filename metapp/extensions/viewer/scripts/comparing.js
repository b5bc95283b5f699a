// A viewer that compares fits with references in panes of one camera, light and exposure: side by side, as a difference, or
// with a wipe.

const COMPARED = {
  beside: "Side by side", all: "Side by side + difference", difference: "Difference in false colours",
  wipe: "Wipe between them", reference: "Reference", fit: "Fit",
};
const PARTS = ["fit", "reference", "wipe", "difference", "measured"];  // the parts that a pane can show, in the order of their numbers in shaders
const DIFFERENCE = "|fit \u2212 reference|";
const MEASURE_EVERY = 1500;  // ms between measurements while a picture improves

class ComparingViewer extends Viewer {
  static curve = 0;  // the curve of `encoded` in shaders
  referenced(fit) { return false; }  // whether there is a reference to compare with
  named(fit) { return "Reference"; }
  shapeOfPane() { return 1; }  // width over height of the picture in a pane
  numbers = [];  // {mean, rms, high} of differences of display values, for each fit with a reference

  comparing() {
    const compared = () => this.fits.some((fit) => this.referenced(fit)), scaled = (s) => ["all", "difference"].includes(s.show) && compared();
    return [
      { name: "show", label: "Compare", type: "choice", value: "beside", when: compared, options: Object.entries(COMPARED) },
      { name: "wipe", label: "Wipe", type: "range", min: 0, max: 1, step: 0.005, value: 0.5, text: (x) => `${Math.round(100 * x)} %`, when: (s) => s.show === "wipe" && compared() },
      { name: "scale", label: "Colours of differences up to", type: "range", min: 0.01, max: 1, step: 0.01, value: 0.2, text: percent, when: scaled },
    ];
  }

  // Return the panes to show, [{fit: index, part}]; all fits share one reference.
  parts() {
    const { show } = this.settings, all = this.fits.map((_, fit) => fit), known = all.filter((fit) => this.referenced(this.fits[fit]));
    const fits = all.map((fit) => ({ fit, part: "fit" })), [first] = known;
    const differences = known.map((fit) => ({ fit, part: "difference" }));
    if (first === undefined || show === "fit") return fits;
    if (show === "reference") return [{ fit: first, part: "reference" }];
    if (show === "beside" || show === "all") return [{ fit: first, part: "reference" }, ...fits, ...(show === "all" ? differences : [])];
    return fits.map((each) => (known.includes(each.fit) ? { fit: each.fit, part: show } : each));
  }

  // Return the panes {fit, part, x, y, width, height} in px of the canvas from its upper left corner.
  arrange() {
    const ratio = this.renderer.getPixelRatio(), size = this.renderer.getDrawingBufferSize(new THREE.Vector2()), parts = this.parts(), before = this.panes?.[0];
    const foot = parts.some(({ part }) => part === "difference") ? LEGEND * ratio : 0, shape = this.shapeOfPane(), gap = GAP * ratio;
    this.panes = parts;
    this.overlay.label();
    const rough = gridOf(parts.length, size.x, size.y, { shape, foot, gap }), head = this.strip && rough.length ? headOf(this.overlay.labels, rough[0].width / ratio) : 0;
    const cells = gridOf(parts.length, size.x, size.y, { shape, foot, gap, head: Math.ceil(head * ratio) });
    this.panes = cells.map((cell, i) => ({ ...parts[i], ...cell }));
    const [now] = this.panes;
    return Boolean(now) && (now.width !== before?.width || now.height !== before?.height);  // whether pictures have another size
  }

  // Return the pane of an event or a place, and the place in this pane in px: {pane, fit, x, y, width, height}.
  paneAt({ clientX, clientY }) {
    const box = this.element.getBoundingClientRect(), ratio = this.renderer.getPixelRatio(), [px, py] = [(clientX - box.left) * ratio, (clientY - box.top) * ratio];
    const away = (pane) => Math.hypot(Math.max(pane.x - px, px - pane.x - pane.width, 0), Math.max(pane.y - py, py - pane.y - pane.height, 0));
    const pane = this.panes.reduce((best, each, i) => (away(each) < away(this.panes[best]) ? i : best), 0), { fit, x, y, width, height } = this.panes[pane];
    return { pane, fit, x: (px - x) / ratio, y: (py - y) / ratio, width: width / ratio, height: height / ratio };
  }

  // Set the uniforms of SHOWING and draw the panes; `each(i)` sets further uniforms of fit i.
  _shown() {
    return { map: null, referenceMap: null, exposure: 1, full: 1, wipe: 0.5, curve: 0, show: 0, mapScale: 1, column: new THREE.Vector4(), paper: new THREE.Vector3() };
  }
  _columns(material, each = () => {}) {
    const { renderer } = this, ratio = renderer.getPixelRatio(), size = renderer.getDrawingBufferSize(new THREE.Vector2()), u = material.uniforms;
    this._common(material);
    renderer.setRenderTarget(null);
    renderer.setClearColor(0x17181b, 1);
    renderer.clear();
    renderer.setScissorTest(true);
    for (const pane of this.panes) {
      const bottom = size.y - pane.y - pane.height;
      this._of(material, pane.fit, pane.part);
      u.column.value.set(pane.x, bottom, pane.width, pane.height);
      each(pane.fit, pane);
      renderer.setScissor(pane.x / ratio, bottom / ratio, pane.width / ratio, pane.height / ratio);
      this._fill(material, null);
    }
    renderer.setScissorTest(false);
    this._measure(material, each);
  }
  _common(material) {
    const { settings } = this, u = material.uniforms;
    u.exposure.value = 2 ** settings.exposure; u.full.value = settings.scale; u.wipe.value = settings.wipe; u.curve.value = this.constructor.curve;
    u.paper.value.setScalar({ dark: 0.09, gray: 0.5, white: 1 }[settings.paper]);
  }
  _of(material, fit, part) {
    const u = material.uniforms, own = this.lightOf(fit);
    u.map.value = own.map; u.referenceMap.value = own.reference; u.mapScale.value = own.scale; u.show.value = PARTS.indexOf(part);
  }

  finished() { return true; }  // whether the picture has stopped improving

  // Measure all fits that have a reference, every MEASURE_EVERY at most, and once more when the picture is finished.
  _measure(material, each) {
    const key = JSON.stringify([this.settings, this.panes, this.count]), now = performance.now();
    if (key === this.measuredAs || !this.panes.length || (!this.finished() && now - (this.measuredAt ?? 0) < MEASURE_EVERY)) return;
    this.measuredAs = key; this.measuredAt = now;
    const { width, height } = this.panes[0], wanted = this.settings.show !== "fit";
    const target = new THREE.WebGLRenderTarget(width, height, { type: THREE.FloatType, ...NEAREST, depthBuffer: false }), values = new Float32Array(4 * width * height);
    this.numbers = this.fits.map((fit, i) => {
      if (!wanted || !this.referenced(fit)) return null;
      const pane = { fit: i, part: "measured", x: 0, y: 0, width, height };
      this._of(material, i, "measured");
      material.uniforms.column.value.set(0, 0, width, height);
      each(i, pane);
      this._fill(material, target);
      this.renderer.readRenderTargetPixels(target, 0, 0, width, height, values);
      return summed(values);
    });
    target.dispose();
    this.overlay.tell();
  }
}

// Return mean, root mean square and 95th percentile of differences in [0, 1] over pixels [difference, -, -, coverage].
function summed(values) {
  const bins = new Float64Array(1001);
  let [total, sum, squares] = [0, 0, 0];
  for (let i = 0; i < values.length; i += 4) {
    const [difference, share] = [values[i], values[i + 3]];
    total += share; sum += share * difference; squares += share * difference ** 2;
    bins[Math.round(1000 * clamp(difference, 0, 1))] += share;
  }
  let [high, below] = [0, 0];
  while (high < 1000 && (below += bins[high]) < 0.95 * total) high++;
  return total ? { mean: sum / total, rms: Math.sqrt(squares / total), high: high / 1000 } : null;
}

const toldNumbers = ({ mean, rms, high }) => `mean ${percent(mean)}, RMS ${percent(rms)}, 95 % of px below ${percent(high)}`;
