// The part of a flat picture that panes show. Wheel, two fingers, + and - zoom; a button that is not the first one, two fingers
// and arrow keys move it, and 0 shows all. The first button, one finger and arrow keys move the lamp, where the picture has one.

const CLOSEST = 32;  // greatest factor by which a picture is enlarged

class Framing {
  zoom = 1; x = 0; y = 0;  // the place in the middle of panes, from -1 to 1 across the picture

  constructor(viewer) {
    this.viewer = viewer; this.pointers = new Map();
    const canvas = viewer.renderer.domElement, on = (name, does, options) => canvas.addEventListener(name, (event) => { if (viewer.isFlat) does(event); }, options);
    on("wheel", (event) => { event.preventDefault(); this.zoomBy(2 ** (-event.deltaY * (event.deltaMode ? 0.05 : 0.002)), event); }, { passive: false });
    on("contextmenu", (event) => event.preventDefault());
    on("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); this.pointers.set(event.pointerId, event); });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
    on("pointermove", (event) => this._drag(event));
  }

  // Return half the sides of the picture at zoom 1, and the pointer's place from the middle of its pane, all in px of the page.
  _measures(event) {
    const { x, y, width, height } = this.viewer.paneAt(event), [wide, high] = this.viewer.flatMargins(width / height);
    return { across: width / wide / 2, down: height / high / 2, right: x - width / 2, up: height / 2 - y };
  }

  _drag(event) {
    const before = this.pointers.get(event.pointerId), other = [...this.pointers.values()].find((each) => each.pointerId !== event.pointerId);
    if (!before) return;
    this.pointers.set(event.pointerId, event);
    if (!other && event.buttons & 1 && this.viewer.hasFlatLamp) return this.viewer.overlay.lampTo(event);
    const share = other ? 0.5 : 1;  // of two fingers each moves the picture half as far
    this.moveBy(share * (event.clientX - before.clientX), share * (before.clientY - event.clientY), event);
    if (!other) return;
    const apart = (one) => Math.max(Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY), 1);
    this.zoomBy(apart(event) / apart(before), event);
  }

  // Move the picture by px of the page to the right and up.
  moveBy(right, up, event) {
    const { across, down } = this._measures(event);
    this._put(this.zoom, this.x - right / across / this.zoom, this.y - up / down / this.zoom);
  }

  // Enlarge by a factor; what is seen at the pointer stays there.
  zoomBy(times, event) {
    const { across, down, right, up } = this._measures(event), zoom = clamp(this.zoom * times, 1, CLOSEST), more = 1 / this.zoom - 1 / zoom;
    this._put(zoom, this.x + right / across * more, this.y + up / down * more);
  }

  _put(zoom, x, y) {
    const most = 1 - 1 / zoom;  // the whole picture stands in the middle
    Object.assign(this, { zoom, x: clamp(x, -most, most), y: clamp(y, -most, most) });
    this.viewer.restart();
  }

  // Return what a key does, or undefined.
  key({ key, shiftKey }) {
    const [right, up] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[key] ?? [0, 0], step = 0.2 / this.zoom;
    if (right || up) return () => (this.viewer.hasFlatLamp ? this.viewer.overlay.stepLamp(right, up, shiftKey) : this._put(this.zoom, this.x + right * step, this.y + up * step));
    const zoom = { "+": Math.min(this.zoom * 1.25, CLOSEST), "-": Math.max(this.zoom / 1.25, 1), 0: 1 }[key];
    return zoom && (() => this._put(zoom, this.x, this.y));
  }
}
