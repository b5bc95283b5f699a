// What lies over the columns of a ShapeViewer: labels, and handles of wipe and lamp.

class Overlay {
  constructor(viewer) {
    this.viewer = viewer;
    this.columns = viewer.fits.map((fit, i) => {
      const label = make("div", { className: "label" }), wipe = make("div", { className: "wipe" });
      const lamp = make("button", { type: "button", className: "lamp", title: "Drag the lamp" });
      viewer.element.append(label, lamp, wipe);
      this._drag(lamp, (event) => this._lampTo(event, i));
      this._drag(wipe, (event) => {
        const { x, width } = viewer.columnAt(event);
        viewer.set("wipe", clamp(x / width, 0, 1));
      });
      return { label, lamp, wipe };
    });
    this._pointers(viewer.renderer.domElement);
  }

  _drag(element, move) {
    element.addEventListener("pointerdown", (event) => { element.setPointerCapture(event.pointerId); this.viewer.moving(true); event.preventDefault(); });
    element.addEventListener("pointermove", (event) => { if (element.hasPointerCapture(event.pointerId)) move(event); });
    element.addEventListener("lostpointercapture", () => this.viewer.moving(false));
  }

  _pointers(canvas) {
    const { viewer } = this;
    canvas.addEventListener("pointerdown", () => viewer.moving(true));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => viewer.moving(false));
    canvas.addEventListener("pointermove", (event) => { if (!event.buttons) viewer.pointed?.(viewer.columnAt(event)); });
  }

  // The size of a column, and the radius at which a lamp's handle is seen from aside.
  _size() {
    const { element, fits } = this.viewer, width = element.clientWidth / fits.length, height = element.clientHeight;
    return { width, height, half: Math.min(width, height) * 0.46 };
  }

  // The lamp's handle: its angle from the line of sight grows with the distance from the middle, so that all directions are within reach.
  _lampTo(event, column) {
    const { viewer } = this, box = viewer.element.getBoundingClientRect(), { width, height, half } = this._size();
    const x = (event.clientX - box.left - (column + 0.5) * width) / half, y = -(event.clientY - box.top - height / 2) / half;
    const radius = Math.min(Math.hypot(x, y), 1.41), cosine = 1 - radius * radius, sine = Math.sqrt(Math.max(1 - cosine * cosine, 0));
    const angle = Math.atan2(y, x), own = new THREE.Vector3(sine * Math.cos(angle), sine * Math.sin(angle), cosine);
    viewer.lampAt.copy(own.transformDirection(viewer.camera.matrixWorld));
    viewer.restart();
  }

  place() {
    const { viewer } = this, { settings, camera } = viewer, { width, height, half } = this._size();
    const lamp = viewer.lampAt.clone().transformDirection(camera.matrixWorldInverse.copy(camera.matrixWorld).invert());
    const radius = Math.sqrt(Math.max(1 - lamp.z, 0)), flat = Math.hypot(lamp.x, lamp.y) || 1;
    this.columns.forEach((each, i) => {
      const left = i * width, fit = viewer.fits[i], text = this._text(fit);
      each.lamp.hidden = !viewer.lampShown();
      each.lamp.classList.toggle("behind", lamp.z < 0);
      each.lamp.style.left = `${left + width / 2 + half * radius * lamp.x / flat}px`;
      each.lamp.style.top = `${height / 2 - half * radius * lamp.y / flat}px`;
      each.wipe.hidden = viewer.shown(fit) !== "wipe";
      each.wipe.style.left = `${left + width * settings.wipe}px`;
      Object.assign(each.label.style, { left: `${left + 8}px`, maxWidth: `${width - 16}px` });
      each.label.hidden = !text;
      each.label.textContent = text;
    });
  }

  // Which of several fits it is, and what of it is shown where it is not the fit.
  _text(fit) {
    const { viewer } = this, shown = viewer.shown(fit), { gain } = viewer.settings;
    const named = viewer.fits.length > 1 ? [fit.label, fit.caption].filter(Boolean).join(": ") : "";
    const what = shown === "fit" ? "" : shown === "difference" ? `Difference times ${gain}` : COMPARED[shown].replace("Reference", viewer.named(fit));
    return [named, what].filter(Boolean).join("; ");
  }
}
