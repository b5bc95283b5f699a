// Progressive drawing: sample after sample, each in tiles, so that the page answers meanwhile.
//
// A coarse picture of few pixels comes first; then all pixels, tile by tile over it. Under a light map the first picture is
// lit by blurred maps (`FIRST_LOOK`), and samples replace it little by little; under a lamp it is a faint surround.

const MINUTE = 60000;  // ms
const PIECE = 50;      // ms of drawing, after which the page may answer
const BLENDED = 24;    // number of samples whose mean counts as much as the first look
const SURROUND = 0.15; // share of the light map that is visible under a lamp

// A picture at a share of all pixels across: its samples, their sum, and the surface that is seen at each pixel.
class Level {
  constructor(detail, fits, pane) {
    this.detail = detail; this.pane = pane;
    [this.width, this.height] = [pane.width, pane.height].map((each) => Math.ceil(each * detail));
    const options = { type: THREE.FloatType, format: THREE.RGBAFormat, ...NEAREST, depthBuffer: false, generateMipmaps: false };
    const made = (more) => new THREE.WebGLRenderTarget(fits * this.width, this.height, { ...options, count: 2, ...more });
    this.sample = made(); this.sums = [made(), made()]; this.look = made({ type: THREE.HalfFloatType }); this.buffer = made({ count: 3, depthBuffer: true });
    this.begin();
  }
  begin() { this.count = 0; this.tiles = null; this.looked = false; this.spent = 0; }
  get begun() { return this.tiles !== null || this.count > 0; }
  get sum() { return this.sums[this.count & 1]; }
  get next() { return this.sums[1 - (this.count & 1)]; }
  // Return the share of the next sample that is drawn.
  get part() { return this.tiles ? 1 - this.tiles.reduce((sum, { width, height }) => sum + width * height, 0) / (this.sum.width * this.height) : 0; }
  free() { [this.sample, ...this.sums, this.look, this.buffer].forEach((each) => each.dispose()); }
}

class DrawnViewer extends ComparingViewer {
  count = 0;     // number of samples of all pixels
  cost = 0;      // ms of a sample of all pixels; 0 if not known yet
  lookCost = 0;  // ms of a first look at all pixels
  side = 16;     // side in px of a tile that takes PIECE
  moves = false;
  stale = true;  // whether the screen shows a picture of settings that have changed
  shownAt = 0;
  showCost = 0;  // ms that putting a picture onto the screen takes
  stopped = false;

  constructor(stage, group, redraw) { super(stage, group, () => { this.stale = true; redraw(); }); }

  get detail() { return this._top().detail; }
  get buffer() { return this._top().buffer; }
  _top() { return this.fine.begun || !this.coarse.begun ? this.fine : this.coarse; }

  // Return shares of pixels across: of the picture that is drawn at once, and of the picture at rest.
  _details() {
    const { light } = this.lighting(), before = this.fine?.detail, looks = light === "map" || this.surrounded() ? this.lookCost : 0;
    const cost = looks + (this.moves && light === "map" ? 0 : this.cost), left = Math.max(1.4 * PIECE - this.showCost, 0.4 * PIECE);
    const coarse = this.cost ? clamp(Math.sqrt(left / cost), 0.1, 1) : 0.25;
    if (light === "lamp") return [coarse, 1];
    if (light === "studio") return [coarse, clamp(Math.sqrt(2000 / Math.max(this.cost, 1)), 0.25, 1)];
    return [coarse, this.cost > 2000 || (before === 0.5 && this.cost > 1000) ? 0.5 : 1];  // between both thresholds the share stays: each change begins a picture anew
  }

  _targets() {
    const [coarse, fine] = this._details(), [pane] = this.panes, made = (detail) => new Level(detail, this.fits.length, pane);
    const kept = (level, detail) => level?.pane.width === pane.width && level.pane.height === pane.height && Math.abs(level.detail - detail) < 0.15 * level.detail;
    for (const [name, detail] of [["coarse", coarse], ["fine", fine]]) {
      if (kept(this[name], detail)) continue;
      this[name]?.free();
      this[name] = made(detail);
    }
  }

  moving(on) {
    this.moves = on;
    if (this.panes?.length) this._targets();
    if (!on) this.redraw();
  }

  restart() {
    this.count = 0; this.stopped = false;
    [this.coarse, this.fine].forEach((each) => each?.begin());
    this.redraw(); this.overlay?.place();
  }

  // Return the number of samples of a picture; under a light map no more than a minute has time for.
  most() {
    const { light } = this.lighting(), cost = Math.max(this.cost * this.fine.detail ** 2, 1);
    if (light === "lamp") return 16;
    if (light === "studio") return (cost > 500 ? 1 : 4) * this.chunks;
    return clamp(Math.round(MINUTE / cost), 64, 1024);
  }
  get chunks() { return 16; }  // number of samples among which the studio's lights are divided
  surrounded() { return this.settings.view === "free" && this.lampShown() && this.settings.surround; }
  finished() { return this.stopped || this.count >= this.most(); }

  draw() {
    if (!this.panes?.length || !this.fine) return false;
    if (!this.finished()) this._improve(performance.now() + PIECE);
    const begin = performance.now();
    if (this.stale || this.finished() || begin - this.shownAt > 4 * this.showCost) {
      this._show();
      this.renderer.getContext().readPixels(0, 0, 1, 1, 0x1908, 0x1401, new Uint8Array(4));  // waits until everything is drawn
      if (this.coarse.looked || this.coarse.count || this.fine.looked || this.fine.count) this.element.classList.remove("waiting");
      this.stale = false; this.shownAt = performance.now(); this.showCost = this.shownAt - begin;
    }
    (this.bar ??= new Progress(this)).show();
    return Boolean(this.awaited) || (!this.finished() && !(this.moves && this._top().begun && !this._level()));
  }
  _wait(target) { this.renderer.readRenderTargetPixels(target, 0, 0, 1, 1, target.textures[0].type === THREE.FloatType ? new Float32Array(4) : new Uint16Array(4)); }  // waits until the target is drawn

  // Return the picture to draw next: the coarse one if it is missing, unless all pixels take no longer.
  _level() {
    const { coarse, fine } = this, map = this.lighting().light === "map", fast = this.cost && this.cost * fine.detail ** 2 < 2 * PIECE;
    if (fast || (coarse.count && !this.moves)) return fine;
    if (this.moves && map && this.cost) return coarse.looked ? null : coarse;
    if (coarse.count) return this.moves ? null : fine;
    return map && this.cost ? fine : coarse;
  }

  _improve(until) {
    const level = this._level();
    if (!level) return;
    if (!level.tiles) this._begin(level);
    if (this.moves && this.cost && level === this.coarse && this.lighting().light === "map") return;  // the first look is enough
    while (level.tiles.length && (this.moves || performance.now() < until)) this._tile(level);
    if (level.tiles.length) return;
    level.count += 1; level.tiles = null;
    const cost = level.spent / level.detail ** 2;
    if (!this.cost) this.cost = cost;
    else if (level === this.fine) this.cost = 0.7 * this.cost + 0.3 * cost;  // not of the coarse picture, where costs that do not depend on pixels would count too much
    level.spent = 0;
    this.count = this.fine.count;
    const { fine } = this;
    this._targets();
    if (this.fine !== fine) this.count = 0;
  }

  // Draw the surface that is seen at each pixel, for all tiles of a sample, and the first look before the first sample.
  _begin(level) {
    const { renderer } = this, view = this.view(this._aspect()), { light, lamp, power } = this.lighting();
    const shift = light === "studio" ? Math.floor(level.count / this.chunks) : level.count;
    const jitter = [halton(shift + 1, 2) - 0.5, halton(shift + 1, 3) - 0.5];
    renderer.setClearColor(0, 0);
    renderer.setRenderTarget(level.buffer);
    renderer.clear();
    this.materials.forEach((material, i) => {
      const u = material.uniforms, own = this.lightOf(i);
      u.toClip.value = view.matrix; u.eye.value = view.eye; u.parallel.value = view.parallel; u.towardsEye.value = view.towardsEye;
      u.jitter.value.set(2 * jitter[0] / level.width, 2 * jitter[1] / level.height);
      u.light.value = { lamp: 0, map: 1, studio: 2 }[light]; u.frame.value = level.count; u.chunks.value = this.chunks;
      u.lamp.value = lamp; u.flashPower.value = power; u.studio.value = this.studio ?? null;
      u.map.value = own.map; u.referenceMap.value = own.reference; u.places.value = own.places; u.mapSize.value = own.size; u.mapTotal.value = own.total;
      u.matte.value = own.matte; u.referenceMatte.value = own.referenceMatte; u.mapScale.value = own.scale; u.mapTurn.value = this.settings.turn / 360;
      this.beforeDraw(u, i, level);
      level.buffer.viewport.set(i * level.width, 0, level.width, level.height);
      this.mesh.material = material.seen;
      renderer.setRenderTarget(level.buffer);
      renderer.render(this.scene, this.camera);
      level.buffer.textures.forEach((each, k) => { u[`seen${k}`].value = each; });
    });
    level.tiles = this.materials.map((_, fit) => ({ fit, x: 0, y: 0, width: level.width, height: level.height }));
    if (level.count) return;
    renderer.setClearColor(0, -1);  // marks pixels that are not drawn yet
    renderer.setRenderTarget(level.next);
    renderer.clear();
    if (light === "map" || this.surrounded()) this._lookFirst(level);
  }

  _lookFirst(level) {
    const begin = performance.now();
    this.materials.forEach((material, i) => {
      this.prepare?.(material);
      level.look.viewport.set(i * level.width, 0, level.width, level.height);
      this._bind(material);
      this._fill(material.look, level.look);
    });
    this._wait(level.look);
    if (this.materials[0].looked) this.lookCost = (performance.now() - begin) / level.detail ** 2;  // the first call compiles, and its time says nothing
    this.materials.forEach((material) => { material.looked = true; });
    level.looked = true;
  }

  // Return the next tile: a tile that is too large is halved, and the half nearer to the middle comes first.
  _tile(level) {
    const tile = level.tiles.pop(), { fit, x, y, width, height } = tile, material = this.materials[fit], side = material.compiled ? this.side : 16;
    if (Math.max(width, height) > side) {
      const wide = width >= height, first = Math.ceil((wide ? width : height) / 2);
      const halves = wide ? [{ ...tile, width: first }, { ...tile, x: x + first, width: width - first }] : [{ ...tile, height: first }, { ...tile, y: y + first, height: height - first }];
      const away = (each) => Math.hypot(each.x + each.width / 2 - level.width / 2, each.y + each.height / 2 - level.height / 2);
      level.tiles.push(...halves.sort((a, b) => away(b) - away(a)));
      return;
    }
    const begin = performance.now(), { sample, sum, next } = level, left = fit * level.width, add = this.adding.uniforms;
    sample.viewport.set(left, 0, level.width, level.height);
    for (const target of [sample, next]) { target.scissor.set(left + x, y, width, height); target.scissorTest = true; }
    this._bind(material);
    this._fill(material, sample);
    [add.a0.value, add.a1.value] = sum.textures; [add.b0.value, add.b1.value] = sample.textures; add.keep.value = level.count ? 1 : 0;
    this._fill(this.adding, next);
    next.scissorTest = false;
    this._wait(next);
    const took = performance.now() - begin;
    if (material.compiled) {
      level.spent += took;
      if (2 * Math.min(width, height) >= side) this.side = clamp(this.side * clamp(Math.sqrt(PIECE / Math.max(took, 1)), 0.5, 2), 16, 8192);
    }
    material.compiled = true;
  }

  _show() {
    const { settings, coarse, fine } = this, level = this._top(), u = this.showing.uniforms, view = this.view(this._aspect()), { light } = this.lighting();
    const under = level === fine && !fine.count && coarse.count ? coarse : null, share = level.count / this.most();
    [u.fit.value, u.reference.value] = (level.count ? level.sum : level.next).textures;
    [u.fitUnder.value, u.referenceUnder.value] = (under ?? level).sum.textures;
    [u.fitLook.value, u.referenceLook.value] = level.look.textures;
    u.samples.value = Math.max(level.count, 1); u.scale.value = level.detail; u.underScale.value = under?.detail ?? 0;
    u.looked.value = level.looked; u.surround.value = this.surrounded() ? SURROUND : 0;
    u.trust.value = light !== "map" ? 1 : share >= 1 ? 1 : level.count / (level.count + BLENDED * (1 - share));
    u.mapBehind.value = settings.behind && light === "map"; u.parallel.value = view.parallel; u.eye.value = view.eye;
    u.fromClip.value = view.matrix.clone().invert(); u.mapTurn.value = settings.turn / 360;
    this._columns(this.showing, (fit) => { u.first.value = fit * level.width; u.underFirst.value = fit * (under?.width ?? 0); });
  }
  _aspect() { return this.panes[0].width / this.panes[0].height; }
  lightOf(column) { return this.light; }
  beforeDraw(uniforms, column, level) {}

  _fill(material, target) {
    this.whole.material = material;
    this.renderer.setRenderTarget(target);
    this.renderer.render(this.wholeScene, this.camera);
  }
}

// The progress of a picture that takes seconds, and a button that stops it.
class Progress {
  constructor(viewer) {
    this.viewer = viewer;
    this.bar = make("progress", { max: 1, value: 0 }); this.text = make("span");
    this.button = make("button", { type: "button", onclick: () => { viewer.stopped = !viewer.stopped; viewer.redraw(); } });
    this.box = make("div", { className: "progress", hidden: true }, this.bar, this.text, this.button);
    viewer.element.append(this.box);
  }

  show() {
    const { viewer } = this, { fine, cost, stopped } = viewer, most = viewer.most(), done = Math.min((fine.count + (fine.count < most ? fine.part : 0)) / most, 1);
    const seconds = (1 - done) * most * cost * fine.detail ** 2 / 1000;
    this.long = (this.long && fine.begun && done < 1) || seconds > 3;
    this.box.hidden = viewer.moves || done === 1 || (!stopped && !this.long && cost > 0);
    this.bar.value = done;
    const said = `${fine.count} of ${most} samples${stopped ? ", stopped" : cost ? `, ${Math.max(Math.ceil(seconds), 1)} s left` : ""}`;
    if (this.text.textContent !== said) this.text.textContent = said;
    this.button.textContent = stopped ? "Go on" : "Stop";
  }
}
