// The viewer of pictures: side by side or one at a time, a wipe and the difference of two, errors against a reference, tiles,
// texels.
//
// pictures: display values of 8 bits.
// arrays: linear radiance [H, W, 1 or 3] of any unit, which is tone-mapped here as in metapp's PNGs.
// facts, all of which are optional:
//   pictures   [{title, name, tiles, told, error, part, row, chart}]: the panels, in order; by default all, by name.
//              name: a name of `pictures` or `arrays`; in its place chart: the argument of `drawChart`. tiles: "whole" if the
//              edges of the picture meet, "seams" if they do not. told: the text of the label after the title. error: whether to
//              show the error against the reference. part: [x, y, width, height] of the region that is enlarged. row: the row of
//              the view, if there is room for rows.
//   compared   [left, right]: titles of the pair that is compared first; by default reference and fit.
//   reference  title of the radiance by whose mean all pictures are exposed, and against which errors are; by default each
//              picture is exposed by its own mean.
//   region     [x, y, width, height] of the region that is marked in pictures.
//   notes      [text].

const FITTED = -6;  // value of the setting `zoom`, a logarithm to base 2, that stands for as large as fits in the view
const LARGEST = 6;  // greatest value of the setting `zoom`

class PicturesViewer extends Viewer {

  async open() {
    this.canvas = make("canvas", { tabIndex: 0 });
    this.canvas.setAttribute("aria-label", "Pictures: drag or arrow keys move, wheel or + and - zoom, 0 fits them in the view");
    this.pointed = make("div", { className: "label pointed", hidden: true });
    this.pointed.style.top = "auto";
    this.element.append(this.canvas, this.pointed);
    this.overlays = []; this.pointers = new Map(); this.panels = [];
    await this._load();
    this._listen();
  }

  // Pictures by title, for each fit.
  async _load() {
    this.sets = await Promise.all(this.fits.map(async (fit) => {
      const specs = fit.facts.pictures ?? [...Object.keys(fit.pictures), ...Object.keys(fit.arrays)].map((name) => ({ title: name, name }));
      const known = new Map(), load = (name) => known.get(name) ?? known.set(name, Raster.of(name, fit)).get(name);
      const rasters = await Promise.all(specs.map(async ({ chart, name, part }) => (chart ? new Chart(chart) : part ? (await load(name)).part(part) : load(name))));
      return new Map(specs.map((spec, i) => [spec.title, { ...spec, raster: rasters[i] }]));
    }));
    this.titles = [...new Set(this.sets.flatMap((set) => [...set].filter(([, { chart, error, part }]) => !chart && !error && !part).map(([title]) => title)))];
    this.derived = new Map();
  }

  facts(name) { return this.fits.map((fit) => fit.facts[name]).find((value) => value !== undefined); }

  controls() {
    const { titles } = this, all = this.sets.flatMap((set) => [...set.values()]), options = titles.map((title) => [title, title]);
    const usual = titles.includes("reference") && titles.includes("fit") ? ["reference", "fit"] : [titles[0], titles.at(-1)];
    const [left, right] = this.facts("compared") ?? usual, several = titles.length > 1, pair = (s) => ["wipe", "difference"].includes(s.show);
    const hdr = all.some((each) => each.raster.radiance), tiled = all.some((each) => each.tiles);
    const shows = [["all", "Side by side"], ["one", "One at a time"], ["wipe", "Wipe between two"], ["difference", "Difference of two, in false colours"]];
    if (this.facts("reference")) shows.push(["error", "Error against the reference"]);
    const derived = all.some((each) => each.error), zoomed = () => `${parseFloat((100 * (this.zoom ?? 1)).toPrecision(4))} %`;
    return [
      { name: "show", label: "Compare", type: "choice", value: "all", options: shows, when: () => several },
      { name: "one", label: "Picture", type: "choice", value: right, options, when: (s) => s.show === "one" },
      { name: "left", label: "Left", type: "choice", value: left, options, when: pair },
      { name: "right", label: "Right", type: "choice", value: right, options, when: pair },
      { name: "wipe", label: "Wipe", type: "range", min: 0, max: 1, step: 0.005, value: 0.5, text: (x) => `${Math.round(100 * x)} %`, when: (s) => s.show === "wipe" },
      { name: "scale", label: "Colours of differences up to", type: "range", min: 0.01, max: 1, step: 0.01, value: 0.2, text: percent, when: (s) => s.show === "difference" },
      { name: "most", label: "Colours of errors up to", type: "range", min: 0.05, max: 2, step: 0.05, value: 1, text: (x) => `${Math.round(100 * x)} %`, when: (s) => s.show === "error" || (derived && s.show === "all") },
      { name: "exposure", label: "Exposure", type: "range", min: -6, max: 6, step: 0.1, value: 0, text: (x) => `${x > 0 ? "+" : ""}${x.toFixed(1)} stops`, when: () => hdr },
      { name: "tiles", label: "Tiles", type: "range", min: 1, max: 8, step: 1, value: 1, text: (n) => `${n} x ${n}`, when: () => tiled },
      { name: "seams", label: "Mark where tiles meet", type: "check", value: false, when: () => tiled },
      { name: "zoom", label: "Zoom", type: "range", min: FITTED, max: LARGEST, step: 0.25, value: FITTED, text: (x) => `${zoomed()}${x <= FITTED ? ", fits" : ""}` },
      { name: "fit", label: "Fit to view", type: "action", run: () => this._put({ zoom: FITTED, x: 0, y: 0 }) },
      { name: "whole", label: "100 %", type: "action", run: () => this._put({ zoom: 0 }) },
      { name: "x", label: "", type: "note", value: 0, when: () => false },  // texels from the middle of the pictures to the middle of the view
      { name: "y", label: "", type: "note", value: 0, when: () => false },
      ...[...new Set(this.fits.flatMap((fit) => fit.facts.notes ?? []))].map((text, i) => ({ name: `note${i}`, label: text, type: "note" })),
    ];
  }

  _put(values) {
    Object.assign(this.settings, values);
    this._layout();
    controls.refresh();
    this.redraw();
  }
  changed() { this._layout(); controls?.refresh(); }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.element, ratio = devicePixelRatio;
    Object.assign(this.canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    this.canvas.style.width = `${width}px`;
    this.canvas.style.height = `${height}px`;
    this._layout();
    controls?.refresh();
  }

  // Return the raster of a title in a fit, at the chosen exposure; undefined if the fit has none.
  _raster(i, title) {
    const picture = this.sets[i].get(title);
    if (!picture) return undefined;
    const { raster } = picture, by = this.sets[i].get(this.facts("reference"));
    if (picture.error) return Object.assign(this._error(raster, by.raster), { note: picture.told });
    raster.exposed(2 ** this.settings.exposure / (by ?? picture).raster.mean);
    return Object.assign(raster, { tiles: picture.tiles, note: picture.told });
  }

  // Return the panels to show: [{fit, titles, row, rasters: one, or two of a wipe}]; pictures that fits share are shown once.
  _panels() {
    const { show, one, left, right } = this.settings, panels = [], known = new Set(), reference = this.facts("reference");
    const sources = (i, titles) => titles.map((title) => this._raster(i, title)?.source).join("\n");
    const add = (fit, titles, made = (...rasters) => rasters, said = titles) => {
      const rasters = titles.map((each) => this._raster(fit, each)), key = `${said}\n${sources(fit, titles)}`;
      if (known.has(key) || rasters.some((each) => !each)) return;
      known.add(key);
      const shared = this.fits.every((_, i) => sources(i, titles) === sources(fit, titles)), shown = made(...rasters);
      if (shown.every(Boolean)) panels.push({ fit, titles: said, rasters: shown, shared, row: show === "all" ? this.sets[fit].get(titles[0]).row : undefined });
    };
    this.fits.forEach((_, i) => {
      const titles = [...this.sets[i].keys()].filter((each) => show === "all" || this.titles.includes(each));
      if (show === "one") add(i, [one]);
      else if (show === "wipe") add(i, [left, right]);
      else if (show === "difference") add(i, [left, right], (a, b) => [this._difference(a, b)], [`difference of ${left} and ${right}`]);
      else if (show === "error") titles.filter((each) => each !== reference).forEach((each) => add(i, [each, reference], (a, b) => [this._error(a, b)], [each]));
      else titles.forEach((each) => add(i, [each]));
    });
    return panels;
  }

  _kept(key, makes) {
    if (!this.derived.has(key)) {
      if (this.derived.size > 16) this.derived.clear();
      this.derived.set(key, makes());
    }
    return this.derived.get(key);
  }

  // Return |a - b| of display values in false colours, the mean over channels, where both rasters cover the view.
  _difference(a, b) {
    if (!a || !b) return undefined;
    const { scale } = this.settings, key = `d ${scale} ${a.scale} ${b.scale} ${a.source} ${b.source}`;
    return this._kept(key, () => {
      const width = Math.min(a.width, b.width), height = Math.min(a.height, b.height), made = new Raster(width, height, key);
      const at = (of, i) => 4 * (Math.floor(i / width) * of.width + i % width), off = (i, c) => Math.abs(a.data[at(a, i) + c] - b.data[at(b, i) + c]);
      const values = Float32Array.from({ length: width * height }, (_, i) => (off(i, 0) + off(i, 1) + off(i, 2)) / 3 / 255);
      made.paint((i, c) => heat(values[i] / scale)[c]);
      made.says = (i) => `differs by ${[0, 1, 2].map((c) => off(i, c)).join(", ")} of 255`;
      made.numbers = summed(Float32Array.from({ length: 4 * values.length }, (_, i) => (i % 4 ? 1 : values[i / 4])));
      made.legend = { most: scale, title: "|left \u2212 right| of display values", told: toldNumbers(made.numbers) };
      return Object.assign(made, { tiles: a.tiles && b.tiles && a.width === b.width ? a.tiles : undefined });
    });
  }

  // Return |p - r| / max(r, 1 % of r's mean) in false colours, the mean over channels; see metapp.appearance.metrics.mape.
  _error(picture, reference) {
    if (!picture?.radiance || !reference?.radiance || picture.radiance.length !== reference.radiance.length) return undefined;
    const { most } = this.settings, key = `e ${most} ${picture.source} ${reference.source}`;
    return this._kept(key, () => {
      const { channels, width, height, mean } = picture, made = new Raster(width, height, key), values = new Float32Array(width * height);
      for (let k = 0; k < picture.radiance.length; k++) {
        const r = reference.radiance[k];
        values[Math.floor(k / channels)] += Math.abs(picture.radiance[k] - r) / Math.max(r, 0.01 * reference.mean) / channels;
      }
      made.paint((i, c) => heat(values[i] / most)[c]);
      made.says = (i) => `error ${(100 * values[i]).toPrecision(3)} %`;
      made.legend = { most, title: "|picture \u2212 reference| / reference" };
      return Object.assign(made, { note: `${picture.note ? `${picture.note}, ` : ""}MAPE ${(values.reduce((sum, x) => sum + x, 0) / values.length).toPrecision(3)}` });
    });
  }

  // Return how many texels a raster covers with all of its repetitions.
  _area(raster) {
    const { tiles } = this.settings;
    if (raster.chart) return [1, 1];
    if (raster.times) return [raster.width * raster.times, raster.height * raster.times];
    if (!raster.tiles || (tiles === 1 && this.settings.show !== "wipe")) return [raster.width, raster.height];
    const tiled = this.sets.flatMap((set) => [...set.values()]).filter((each) => each.tiles).map((each) => each.raster);
    return [tiles * Math.max(...tiled.map((each) => each.width)), tiles * Math.max(...tiled.map((each) => each.height))];
  }

  // Return the layouts in rows to choose from: the rows that pictures ask for, else all grids.
  _rows() {
    const { panels } = this, asked = [...new Set(panels.map(({ row }) => row))];
    if (asked.length > 1 && !asked.includes(undefined)) return [asked.sort().map((row) => panels.filter((each) => each.row === row))];
    return panels.map((_, i) => Array.from({ length: Math.ceil(panels.length / (i + 1)) }, (_, k) => panels.slice(k * (i + 1), (k + 1) * (i + 1))));
  }

  // Return rows with their cells: {rows, strips: head and foot of each row, cell, fit: zoom at which a picture of w x h fills a
  // cell}.
  _sized(rows, w, h) {
    const { canvas } = this, ratio = devicePixelRatio, gap = Math.round(GAP * ratio), most = Math.max(...rows.map((row) => row.length));
    const width = Math.floor((canvas.width - gap * (most - 1)) / most);
    this._overlay(width / ratio);
    const strips = rows.map((row) => ({
      head: this.strip ? Math.ceil(ratio * headOf(row.map((panel) => this.overlays[this.panels.indexOf(panel)].label), width / ratio)) : 0,
      foot: row.some(({ rasters }) => rasters[0].legend) ? LEGEND * ratio : 0,
    }));
    const around = strips.reduce((sum, { head, foot }) => sum + head + foot, gap * (rows.length - 1)), cell = [width, Math.floor((canvas.height - around) / rows.length)];
    return { rows, strips, cell, fit: Math.max(Math.min(cell[0] / w, cell[1] / h), 0) };
  }

  // Return cells for all panels, as large as they can be, and the zoom in px of the screen a texel.
  _layout() {
    const { canvas, settings } = this, ratio = devicePixelRatio, gap = Math.round(GAP * ratio);
    if (!canvas.width || !canvas.height || settings.show === undefined) return;
    this.panels = this._panels();
    const areas = this.panels.flatMap((panel) => panel.rasters.map((each) => this._area(each)));
    const [w, h] = [0, 1].map((axis) => Math.max(1, ...areas.map((area) => area[axis])));
    const best = this._rows().map((rows) => this._sized(rows, w, h)).reduce((a, b) => (b.fit > a.fit ? b : a), { fit: 0 });
    if (!best.fit) return;
    this.fitting = best.fit >= 2 ? Math.floor(best.fit) : best.fit >= 1 ? Math.floor(4 * best.fit) / 4 : best.fit;  // whole px a texel, if pictures get little smaller by that
    this.zoom = settings.zoom <= FITTED ? this.fitting : 2 ** settings.zoom;
    if (settings.zoom <= FITTED) Object.assign(settings, { x: 0, y: 0 });
    settings.x = clamp(settings.x, -w / 2, w / 2);
    settings.y = clamp(settings.y, -h / 2, h / 2);
    let top = 0;
    best.rows.forEach((row, k) => {
      const { head, foot } = best.strips[k], [width, height] = best.cell, left = Math.floor((canvas.width - row.length * width - gap * (row.length - 1)) / 2);
      row.forEach((panel, i) => Object.assign(panel, { x: left + i * (width + gap), y: top + head, width, height }));
      top += head + height + foot + gap;
    });
    this._place();
  }

  // Return the place in px of the canvas at which a raster begins.
  _origin(panel, raster) {
    const area = this._area(raster), middle = [panel.x + panel.width / 2, panel.y + panel.height / 2];
    return [0, 1].map((axis) => Math.round(middle[axis] - (area[axis] / 2 + this.settings[axis ? "y" : "x"]) * this.zoom));
  }

  draw() {
    const { canvas } = this, g = canvas.getContext("2d");
    if (!this.panels) this._layout();
    if (!this.panels) return false;
    g.fillStyle = "#17181b";
    g.fillRect(0, 0, canvas.width, canvas.height);
    for (const panel of this.panels) {
      const cut = Math.round(panel.width * this.settings.wipe);
      panel.rasters.forEach((raster, i) => {
        const from = panel.rasters.length === 2 && i ? cut : 0, to = panel.rasters.length === 2 && !i ? cut : panel.width;
        g.save();
        g.beginPath();
        g.rect(panel.x + from, panel.y, to - from, panel.height);
        g.clip();
        this._paint(g, panel, raster);
        g.restore();
      });
    }
    return false;
  }

  _paint(g, panel, raster) {
    const { zoom } = this, [left, top] = this._origin(panel, raster), [w, h] = this._area(raster), { width, height } = raster;
    let n = 0;
    while (zoom * 2 ** n <= 0.5 && Math.min(width, height) >> (n + 1)) n++;
    if (raster.chart) return raster.draw(g, panel);
    const source = raster.level(n), times = raster.times ?? 1;
    g.imageSmoothingEnabled = zoom * times < 2 && zoom !== 1;
    if (w === width * times && h === height * times) g.drawImage(source, left, top, w * zoom, h * zoom);
    else {  // tiles are filtered across their edges
      const pattern = g.createPattern(source, "repeat");
      pattern.setTransform(new DOMMatrix([width * zoom / source.width, 0, 0, height * zoom / source.height, left, top]));
      g.fillStyle = pattern;
      g.fillRect(left, top, w * zoom, h * zoom);
    }
    this._mark(g, raster, left, top);
    if (!this.settings.seams || !raster.tiles) return;
    g.fillStyle = raster.tiles === "seams" ? "#ff5d5d" : "#7fb2ff";
    const line = Math.max(1, Math.round(devicePixelRatio));
    for (let x = 0; x <= w; x += width) g.fillRect(left + Math.round(x * zoom) - (x === w ? line : 0), top, line, h * zoom);
    for (let y = 0; y <= h; y += height) g.fillRect(left, top + Math.round(y * zoom) - (y === h ? line : 0), w * zoom, line);
  }

  // Draw a frame around the region that other panels enlarge.
  _mark(g, raster, left, top) {
    const region = this.facts("region"), line = Math.max(1, Math.round(1.5 * devicePixelRatio));
    if (!region || raster.times || this.settings.show === "one") return;
    const [x, y, width, height] = region.map((each) => each * this.zoom);
    Object.assign(g, { strokeStyle: "#ffe14d", lineWidth: line });
    g.strokeRect(left + x, top + y, width, height);
  }

  png() { return this.canvas; }

  // Make labels, legends and handles of wipes, as many as there are panels.
  _overlay(width) {
    while (this.overlays.length > this.panels.length) Object.values(this.overlays.pop()).forEach((each) => each.remove());
    while (this.overlays.length < this.panels.length) this.overlays.push(this._made(this.overlays.length));
    this.panels.forEach((panel, i) => { this.overlays[i].label.textContent = this._text(panel, width); });
  }

  _made(index) {
    const label = make("div", { className: "label" }), legend = make("canvas", { className: "plot scale" });
    const share = (event) => { const { x, width } = this.panels[index]; return (this._at(event)[0] - x) / width; };
    const wipe = wipeHandle(() => this.settings.wipe, (to) => this._put({ wipe: to }), share);
    this.element.append(label, legend, wipe);
    return { label, legend, wipe };
  }

  // Return the label of a panel of a width in px; narrow panels leave out the text after the title.
  _text(panel, width) {
    const fit = this.fits[panel.fit], several = this.fits.length > 1 && !panel.shared, wide = width > 150 || this.settings.show !== "all";
    const says = (raster) => [wide && raster.note, this._area(raster)[0] > raster.width && raster.tiles === "seams" && "repeated",
      this.settings.seams && { whole: "its edges meet", seams: "its edges do not meet" }[raster.tiles]].filter(Boolean).join(", ");
    const told = panel.rasters.map((raster, k) => [panel.titles[k], says(raster)].filter(Boolean).join(", ")).join(" | ");
    const caption = several && this.settings.show !== "all" && fit.caption;
    return several ? `${[fit.label, caption].filter(Boolean).join(", ")}: ${told}` : told;
  }

  // Place labels, legends and handles over the panels.
  _place() {
    const ratio = devicePixelRatio;
    this.panels.forEach((panel, i) => {
      const { label, legend, wipe } = this.overlays[i], [left, top, width, height] = ["x", "y", "width", "height"].map((name) => panel[name] / ratio);
      label.title = this._text(panel, Infinity);
      Object.assign(label.style, { left: `${left + 4}px`, top: `${top - (this.strip ? label.offsetHeight + 2 : 0)}px` });
      wipe.hidden = panel.rasters.length < 2;
      wipe.setAttribute("aria-valuenow", Math.round(100 * this.settings.wipe));
      Object.assign(wipe.style, { left: `${left + width * this.settings.wipe}px`, top: `${top}px`, height: `${height}px` });
      const scale = panel.rasters[0].legend;
      legend.hidden = !scale;
      Object.assign(legend.style, { left: `${left}px`, top: `${top + height}px`, bottom: "auto" });
      if (scale) drawLegend(legend, width, scale);
    });
    sayNumbers(this.settings.show === "difference" ? this.panels.map(({ titles, rasters: [{ numbers }] }) => `${titles[0]}: ${toldNumbers(numbers)}`).join("; ") : "");
    this.pointed.style.bottom = "8px";
    this.pointed.style.left = "8px";
  }

  _at(event) {
    const box = this.canvas.getBoundingClientRect();
    return [(event.clientX - box.left) * this.canvas.width / box.width, (event.clientY - box.top) * this.canvas.height / box.height];
  }
  _panelAt([x, y]) { return this.panels.find((each) => x >= each.x && x < each.x + each.width && y >= each.y && y < each.y + each.height); }

  // Return the texel under the pointer, {title, raster, x, y}; null beside the pictures.
  pick(place) {
    const panel = this._panelAt(place);
    if (!panel) return null;
    const which = panel.rasters.length === 2 && place[0] >= panel.x + panel.width * this.settings.wipe ? 1 : 0;
    const raster = panel.rasters[which], times = raster.times ?? 1, origin = this._origin(panel, raster), area = this._area(raster);
    const [x, y] = [0, 1].map((axis) => Math.floor((place[axis] - origin[axis]) / this.zoom));
    if (raster.chart || x < 0 || y < 0 || x >= area[0] || y >= area[1]) return null;
    return { title: panel.titles[which], raster, x: Math.floor(x / times) % raster.width, y: Math.floor(y / times) % raster.height };
  }

  _tell(event) {
    const picked = this.pick(this._at(event));
    this.pointed.hidden = !picked;
    if (picked) this.pointed.textContent = `${picked.title}, texel ${picked.x}, ${picked.y}: ${picked.raster.told(picked.x, picked.y)}`;
  }

  // Zoom by stops; the texel at a place stays where it is.
  _zoom(stops, place) {
    const panel = this._panelAt(place) ?? this.panels[0], least = Math.log2(Math.min(this.fitting, 1)), before = this.zoom;
    if (!panel) return;
    const stop = clamp(Math.log2(before) + stops, least, LARGEST), after = 2 ** stop;
    if (stop <= Math.log2(this.fitting) && this.fitting <= 1) return this._put({ zoom: FITTED });
    const moved = [place[0] - panel.x - panel.width / 2, place[1] - panel.y - panel.height / 2].map((off) => off / before - off / after);
    this._put({ zoom: stop, x: this.settings.x + moved[0], y: this.settings.y + moved[1] });
  }
  _move(x, y) { this._put({ x: this.settings.x - x / this.zoom, y: this.settings.y - y / this.zoom }); }

  _listen() {
    const { canvas, pointers } = this;
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this._zoom(-event.deltaY * (event.deltaMode ? 0.05 : 0.002), this._at(event));
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); pointers.set(event.pointerId, this._at(event)); });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
    canvas.addEventListener("pointerleave", () => { this.pointed.hidden = true; });
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId), now = this._at(event);
      if (!before) return this._tell(event);
      const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
      pointers.set(event.pointerId, now);
      if (!other) return this._move(now[0] - before[0], now[1] - before[1]);
      const apart = (a) => Math.max(Math.hypot(a[0] - other[0], a[1] - other[1]), 1);
      this._move((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
      this._zoom(Math.log2(apart(now) / apart(before)), [(now[0] + other[0]) / 2, (now[1] + other[1]) / 2]);
    });
    canvas.addEventListener("keydown", (event) => {
      const step = 60 * devicePixelRatio, middle = this.panels[0] && [this.panels[0].x + this.panels[0].width / 2, this.panels[0].y + this.panels[0].height / 2];
      const does = {
        ArrowLeft: () => this._move(step, 0), ArrowRight: () => this._move(-step, 0), ArrowUp: () => this._move(0, step), ArrowDown: () => this._move(0, -step),
        "+": () => this._zoom(0.5, middle), "-": () => this._zoom(-0.5, middle), 0: () => this._put({ zoom: FITTED }), 1: () => this._put({ zoom: 0 }),
      }[event.key];
      if (does && middle && !event.ctrlKey && !event.metaKey) { event.preventDefault(); does(); }
    });
  }
}
VIEWERS.pictures = PicturesViewer;
