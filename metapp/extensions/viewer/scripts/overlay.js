// Elements over the panes of a ShapeViewer: labels, legends, and handles of wipe and lamp, which keys move as well.

const STEP = Math.PI / 36;  // angle in rad by which a key moves the lamp

class Overlay {
  constructor(viewer) {
    this.viewer = viewer; this.each = [];
    this._pointers(viewer.renderer.domElement);
  }
  get labels() { return this.each.map(({ label }) => label); }

  // Make as many labels as there are panes, and set their texts.
  label() {
    const { viewer } = this;
    while (this.each.length > viewer.panes.length) Object.values(this.each.pop()).forEach((element) => element.remove());
    while (this.each.length < viewer.panes.length) this.each.push(this._made(this.each.length));
    viewer.panes.forEach((pane, i) => {
      const text = this._text(pane), { label } = this.each[i];
      Object.assign(label, { hidden: !text, textContent: text });
    });
  }

  _made(index) {
    const { viewer } = this, label = make("div", { className: "label" }), legend = make("canvas", { className: "plot scale" });
    const lamp = make("button", { type: "button", className: "lamp", title: "Drag the lamp, or arrow keys" });
    lamp.setAttribute("aria-label", "Lamp: arrow keys move it");
    const moving = (on) => viewer.moving(on), share = (event) => { const { x, width } = viewer.paneAt(event); return x / width; };
    const wipe = wipeHandle(() => viewer.settings.wipe, (to) => viewer.set("wipe", to), share, moving);
    viewer.element.append(label, legend, lamp, wipe);
    draggable(lamp, (event) => this.lampTo(event), moving);
    lamp.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (!by) return;
      event.preventDefault();
      this.stepLamp(...by, event.shiftKey);
    });
    return { label, legend, lamp, wipe };
  }

  _pointers(canvas) {
    const { viewer } = this;
    canvas.addEventListener("pointerdown", () => viewer.moving(true));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => viewer.moving(false));
    canvas.addEventListener("pointermove", (event) => { if (!event.buttons && viewer.panes?.length) viewer.pointed?.(viewer.paneAt(event)); });
  }

  // Place the lamp's handle: its angle from the line of sight grows with the distance from the middle, so that all directions
  // are within reach.
  lampTo(event) {
    const { viewer } = this, { x, y, width, height } = viewer.paneAt(event), half = halfOf(width, height);
    const [right, up] = [(x - width / 2) / half, -(y - height / 2) / half];
    const radius = Math.min(Math.hypot(right, up), 1.41), cosine = 1 - radius * radius, sine = Math.sqrt(Math.max(1 - cosine * cosine, 0));
    const angle = Math.atan2(up, right), own = new THREE.Vector3(sine * Math.cos(angle), sine * Math.sin(angle), cosine);
    viewer.putLamp(own.transformDirection(viewer.viewerFrame()));
  }

  // Turn the lamp about the object by angles to the right and up, as the object is seen.
  moveLamp(right, up) {
    const { viewer } = this, [x, y] = [0, 1].map((axis) => new THREE.Vector3().setFromMatrixColumn(viewer.viewerFrame(), axis));
    viewer.putLamp(viewer.lampAt.clone().applyAxisAngle(y, right).applyAxisAngle(x, -up));
  }
  stepLamp(right, up, finely) { this.moveLamp(...[right, up].map((each) => each * STEP / (finely ? 5 : 1))); }

  place() {
    const { viewer } = this, { settings, camera, panes } = viewer, ratio = viewer.renderer.getPixelRatio();
    if (!panes || panes.length !== this.each.length) return;
    const lamp = viewer.lampAt.clone().transformDirection(viewer.viewerFrame().clone().invert());
    const radius = Math.sqrt(Math.max(1 - lamp.z, 0)), flat = Math.hypot(lamp.x, lamp.y) || 1;
    this.each.forEach((each, i) => {
      const [left, top, width, height] = ["x", "y", "width", "height"].map((name) => panes[i][name] / ratio), half = halfOf(width, height);
      each.lamp.hidden = !viewer.lampShown();
      each.lamp.classList.toggle("behind", lamp.z < 0);
      each.lamp.style.left = `${left + width / 2 + half * radius * lamp.x / flat}px`;
      each.lamp.style.top = `${top + height / 2 - half * radius * lamp.y / flat}px`;
      each.wipe.hidden = panes[i].part !== "wipe";
      each.wipe.setAttribute("aria-valuenow", Math.round(100 * settings.wipe));
      Object.assign(each.wipe.style, { left: `${left + width * settings.wipe}px`, top: `${top}px`, height: `${height}px` });
      const head = viewer.strip ? each.label.offsetHeight + 2 : 0;
      Object.assign(each.label.style, { left: `${left + 4}px`, top: `${top - head}px` });
      each.legend.hidden = panes[i].part !== "difference";
      Object.assign(each.legend.style, { left: `${left}px`, top: `${top + height}px`, bottom: "auto" });
    });
    this.tell();
  }

  // Set the legends, and the numbers of comparisons below the view.
  tell() {
    const { viewer } = this, { panes, numbers, fits, settings } = viewer, ratio = viewer.renderer.getPixelRatio();
    panes.forEach(({ fit, part, width }, i) => {
      if (part !== "difference") return;
      drawLegend(this.each[i].legend, width / ratio, { most: settings.scale, title: this._measured(fit), told: numbers[fit] ? toldNumbers(numbers[fit]) : "" });
    });
    sayNumbers(fits.map((fit, i) => (numbers[i] && panes.length > 0 ? `${fits.length > 1 ? `${fit.label}: ` : ""}${this._measured(i)} of display values, ${toldNumbers(numbers[i])}` : "")).filter(Boolean).join("; "));
  }
  _measured(fit) { return DIFFERENCE.replace("reference", this.viewer.named(this.viewer.fits[fit]).toLowerCase()); }

  // Return the label of a fit and of the part that is shown; nothing if a fit stands alone.
  _text({ fit: index, part, label }) {
    const { viewer } = this, fit = viewer.fits[index], named = viewer.named(fit);
    const own = [fit.label, viewer.fits.length > 1 && fit.caption].filter(Boolean).join(": ");
    if (label) return label;
    if (part === "reference") return named;
    if (part === "fit" && viewer.panes.length === 1) return "";
    const what = { fit: "Fit", wipe: `${named} | fit`, difference: `Difference from the ${named.toLowerCase()}` }[part];
    return part === "fit" || viewer.fits.length > 1 ? `${what}: ${own}` : what;
  }
}

// The radius at which the lamp's handle stands for light from aside.
const halfOf = (width, height) => Math.min(width, height) * 0.46;

// Call `move(event)` while an element is dragged, and `moving(on)` when dragging begins and ends.
function draggable(element, move, moving = () => {}) {
  element.addEventListener("pointerdown", (event) => { element.setPointerCapture(event.pointerId); element.focus({ preventScroll: true }); moving(true); event.preventDefault(); });
  element.addEventListener("pointermove", (event) => { if (element.hasPointerCapture(event.pointerId)) move(event); });
  element.addEventListener("lostpointercapture", () => moving(false));
}

// Return the handle of a wipe, which pointer and keys move: `get()` and `put(share)` read and set its setting, `share(event)`
// is the share that a pointer stands for.
function wipeHandle(get, put, share, moving) {
  const wipe = make("div", { className: "wipe", tabIndex: 0, title: "Drag, or left and right keys" });
  wipe.setAttribute("role", "slider"); wipe.setAttribute("aria-label", "Wipe");
  draggable(wipe, (event) => put(clamp(share(event), 0, 1)), moving);
  wipe.addEventListener("keydown", (event) => {
    const step = event.shiftKey ? 0.1 : 0.01, to = { ArrowLeft: get() - step, ArrowRight: get() + step, Home: 0, End: 1 }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    put(clamp(to, 0, 1));
  });
  return wipe;
}
