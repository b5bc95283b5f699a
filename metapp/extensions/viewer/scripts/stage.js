// The viewer of shapes in 3D, in panes of one camera: lamp, light map, accumulation. Fit and reference are drawn at once.
//
// A subclass of ShapeViewer gives each fit a material: GLSL with
//   void at_point(vec2 uv)                                sets all that depends on the place alone
//   void response(vec3 wi, vec3 wo, out vec3 fit, out vec3 reference)   BRDF times cosine, in the frame of the shape
//   void first_look(vec3 wo, mat3 frameOf, out vec3 fit, out vec3 reference)   approximate radiance under a map, by `blurred`
//   Lobes lobes(vec3 wo)                                  the lobes that light is sampled from for a direction to the viewer;
//                                                         without any share a perfect mirror, whose response is a reflectance
// and may define
//   #define BENT, mat3 bent()                             the frame of the lobes, in the frame of the shape
//   #define UNLIT, void unlit(inout vec3 fit, inout vec3 reference)   radiance in place of reflected light
// The frame has z along the shape's normal and x along its tangent. All light is linear RGB.

const STUDIO = "studio";  // the name of the studio among `environments`

class ShapeViewer extends DrawnViewer {
  // Members that subclasses override.
  static shapes = ["sphere", "plane", "knot"];
  static lights = [["lamp", "Lamp"], ["map", "Light map"]];
  static stops = 6;  // range of the exposure in stops, either way
  async material(fit) { throw new Error("no material"); }  // -> {glsl, displacement, uniforms}
  lampShown() { return this.settings.light === "lamp" && this.settings.view === "free"; }
  get isFlat() { return this.settings.view === "picture" && this.picture(this.settings) !== null; }  // whether metapp's own picture is shown
  get hasFlatLamp() { return false; }  // whether the lamp of metapp's own picture can be dragged
  picture(settings) { return null; }  // {lamp, eye, half: half the side of an orthographic view} while metapp's own picture is shown

  async open() {
    const [{ thumbnail }] = this.fits;  // a still picture until the first frame
    if (thumbnail) { this.element.classList.add("waiting"); this.element.style.setProperty("--still", `url(${thumbnail})`); }
    this.renderer = this._renderer();
    if (!this.renderer.extensions.has("EXT_color_buffer_float")) throw new Error("WebGL 2 lacks EXT_color_buffer_float here");
    this.renderer.domElement.addEventListener("webglcontextlost", () => this.lost?.());
    this.renderer.domElement.addEventListener("webglcontextrestored", () => this.restored?.());
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    this.renderer.autoClear = false;
    this.renderer.debug.onShaderError = (gl, program, vertex, fragment) => { throw new Error(gl.getShaderInfoLog(fragment) || gl.getShaderInfoLog(vertex)); };
    this.element.append(this.renderer.domElement);
    this.camera = new THREE.PerspectiveCamera(30, 1, 0.1, 50);
    this.camera.position.set(0, 0, 5);
    this.orbit = new THREE.OrbitControls(this.camera, this.renderer.domElement);
    this.orbit.enablePan = false;
    this.orbit.addEventListener("change", () => this.restart());
    Object.assign(this.renderer.domElement, { tabIndex: 0, ariaLabel: "Shapes: drag or arrow keys turn them, + and - move nearer or farther, 0 shows the front" });
    this.renderer.domElement.addEventListener("keydown", (event) => this._key(event));
    this.lampAt = new THREE.Vector3(0.5, 0.7, 0.5).normalize();
    this.scene = new THREE.Scene();
    this.mesh = new THREE.Mesh(shapeOf(this.constructor.shapes[0]));
    this.mesh.frustumCulled = false;
    this.scene.add(this.mesh);
    this.whole = new THREE.Mesh(new THREE.BufferGeometry().setAttribute("position",
      new THREE.BufferAttribute(new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]), 3)));
    this.whole.frustumCulled = false;
    this.wholeScene = new THREE.Scene();
    this.wholeScene.add(this.whole);
    this.adding = this._pass(ADD, { a0: null, a1: null, b0: null, b1: null, keep: 0 });
    this.showing = this._pass(DISPLAY, {
      ...this._shown(), fit: null, reference: null, fitUnder: null, referenceUnder: null, fitLook: null, referenceLook: null,
      samples: 1, scale: 1, first: 0, underScale: 0, underFirst: 0, looked: false, trust: 1, surround: 0,
      mapBehind: false, parallel: false, fromClip: new THREE.Matrix4(), eye: new THREE.Vector3(), mapTurn: 0,
    });
    this.light = await this.ownLight();
    this.materials = [];
    for (const fit of this.fits) this.materials.push(this._made(await this.material(fit)));
    this.settings = {};
    this.overlay = new Overlay(this);
    this.framing = new Framing(this);
  }

  _renderer() {
    try {
      return new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true, powerPreference: "high-performance" });
    } catch (error) {
      throw new Error(`this browser gives no WebGL 2 (${error.message}); turn on its hardware acceleration, or take another browser`);
    }
  }

  async ownLight() { return this.lightFrom(STUDIO); }

  // Return the light maps to choose from: the studio, and the fitted light maps of this page.
  environments() { return [[STUDIO, "Studio"], ...DATA.groups.flatMap(({ kind, title }, i) => (kind === "light" ? [[`${i}`, title]] : []))]; }
  async lightFrom(name) {
    const array = await (name === STUDIO ? shared("light") : numbersOf(DATA.groups[name].fits[0].arrays.map));
    return lightOf(floatsOf(array), ...array.shape.slice(0, 2));
  }
  async relight(promised) {  // takes a light once it is loaded, unless another one is wanted by then
    this.awaited = promised;
    const light = await promised;
    if (this.awaited !== promised) return forget(light);
    forget(this.light);
    [this.light, this.awaited] = [light, null];
    this.restart();
  }

  controls() {
    const { shapes, lights, stops } = this.constructor;
    const own = this.picture({}) !== null;
    return [
      { name: "view", label: "View", type: "choice", value: this.firstView(), options: [["free", "Free"], ["picture", "As in metapp's picture"]], when: () => own },
      { name: "shape", label: "Shape", type: "choice", value: shapes[0], options: shapes.map((name) => [name, SHAPES[name][0]]), when: (s) => s.view === "free" },
      { name: "light", label: "Light", type: "choice", value: lights[0][0], options: lights, when: (s) => lights.length > 1 && s.view === "free" },
      { name: "environment", label: "Environment", type: "choice", value: STUDIO, options: this.environments(), when: (s) => s.light === "map" && s.view === "free" && this.environments().length > 1 },
      { name: "turn", label: "Rotation of the light map", type: "range", min: 0, max: 360, step: 1, value: 0, text: (x) => `${x}\u00b0`, when: (s) => s.light === "map" && s.view === "free" },
      { name: "behind", label: "Show the light map", type: "check", value: false, when: (s) => s.light === "map" && s.view === "free" },
      { name: "file", label: "Another light map (.hdr)", type: "file", accept: ".hdr", run: (file) => this.readLight(file), when: (s) => s.light === "map" && s.view === "free" },
      { name: "surround", label: "Faint surround: 15 % of the light map, about as the material reflects it", type: "check", value: true, when: (s) => lights.length > 1 && s.light === "lamp" && s.view === "free" && (s.map ?? "lit") === "lit" },
      ...this.comparing(),
      { name: "exposure", label: "Exposure", type: "range", min: -stops, max: stops, step: 0.1, value: 0, text: (x) => `${x > 0 ? "+" : ""}${x.toFixed(1)} stops` },
      { name: "paper", label: "Background", type: "choice", value: "dark", options: [["dark", "Dark"], ["gray", "Gray"], ["white", "White"]] },
      ...this.ownControls(),
    ];
  }
  firstView() { return "free"; }
  ownControls() { return []; }

  async readLight(file) {
    let read;
    try { read = new THREE.HDRLoader().parse(await file.arrayBuffer()); } catch (error) { return say(`${file.name} is no light map of Radiance (.hdr): ${error.message}`); }
    const { data, width, height } = read;
    const values = new Float32Array(3 * width * height), float = data instanceof Uint16Array ? fromHalf : (x) => x;
    for (let i = 0; i < width * height; i++) for (let c = 0; c < 3; c++) values[3 * i + c] = float(data[4 * i + c]);
    await this.relight(Promise.resolve(lightOf(values, height, width)));
    say(`Light map: ${file.name}`);
  }

  changed(name) {
    if (name === "light" || name === "view") [this.cost, this.side] = [0, 16];  // each light has its own costs
    if (name === "environment") this.relight(this.lightFrom(this.settings.environment));
    if (name === "shape" || name === "view") this.mesh.geometry = shapeOf(this.shape());
    if (["wipe", "scale", "exposure", "paper"].includes(name)) this.redraw();
    else if (!this._arranged() && name !== "show") this.restart();
    this.redraw();
    this.overlay.place();
  }

  restart() {
    this.orbit.enabled = this.settings.view === "free";  // flat pictures have their `framing`
    super.restart();
  }

  // Return the frame in which the lamp is moved: x right, y up, z towards the viewer, in the world.
  viewerFrame() { return this.isFlat ? new THREE.Matrix4() : this.camera.matrixWorld; }
  putLamp(direction) {
    this.lampAt.copy(direction).normalize();
    this.restart();
  }

  _key(event) {
    const turn = Math.PI / 36, does = this.isFlat ? this.framing.key(event) : {
      ArrowLeft: () => this.look(-turn, 0), ArrowRight: () => this.look(turn, 0), ArrowUp: () => this.look(0, -turn), ArrowDown: () => this.look(0, turn),
      "+": () => this.look(0, 0, 0.9), "-": () => this.look(0, 0, 1 / 0.9), 0: () => { this.camera.position.set(0, 0, 5); this.look(0, 0); },
    }[event.key];
    if (!does || !(this.isFlat || this.orbit.enabled) || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    does();
  }
  // Turn the camera about the object by angles around it and down, and multiply its distance by a factor.
  look(around, down, times = 1) {
    const at = new THREE.Spherical().setFromVector3(this.camera.position);
    this.camera.position.setFromSphericalCoords(clamp(at.radius * times, 1.5, 20), clamp(at.phi + down, 0.01, Math.PI - 0.01), at.theta + around);
    this.camera.lookAt(0, 0, 0);
    this.orbit.update();
    this.restart();
  }

  shape() { return (this.settings.view === "picture" && this.picture(this.settings)?.shape) || this.settings.shape || this.constructor.shapes[0]; }

  _free(material) {
    Object.values(material.uniforms).forEach((each) => { if (each.value?.isTexture && each.own) each.value.dispose(); });
    if (material.block) this.renderer.getContext().deleteBuffer(material.block);
    [material.seen, material.look, material.evaluator, material.albedos].forEach((each) => each?.dispose());
    material.dispose();
  }

  close() {
    this.orbit?.dispose();
    this.materials?.forEach((each) => this._free(each));
    [this.coarse, this.fine].forEach((each) => each?.free());
    Object.values(builtShapes).forEach((each) => each.dispose());  // a shape knows all renderers that drew it
    this.renderer?.dispose();
    this.renderer?.forceContextLoss();
    super.close();
  }

  _pass(fragmentShader, uniforms) {
    const values = Object.fromEntries(Object.entries(uniforms).map(([name, value]) => [name, { value }]));
    return new THREE.RawShaderMaterial({
      glslVersion: THREE.GLSL3, vertexShader: WHOLE, fragmentShader, uniforms: values, depthTest: false, depthWrite: false, blending: THREE.NoBlending,
    });
  }

  _made({ glsl, displacement, uniforms, block = null }) {
    const own = {
      toClip: new THREE.Matrix4(), jitter: new THREE.Vector2(), eye: new THREE.Vector3(), towardsEye: new THREE.Vector3(0, 0, 1), parallel: false,
      light: 0, frame: 0, chunks: 1, lamp: new THREE.Vector3(), flashPower: 1, map: null, referenceMap: null, places: null, studio: null,
      mapSize: new THREE.Vector2(), mapTotal: 1, mapScale: 1, mapTurn: 0, matte: null, referenceMatte: null,
      seen0: null, seen1: null, seen2: null,
    };
    const values = Object.fromEntries(Object.entries(own).map(([name, value]) => [name, { value }]));
    for (const [name, value] of Object.entries(uniforms)) values[name] = { value, own: true };
    const material = this._pass(`${COMMON}\n${PIXEL}\n${glsl}\n${FRAGMENT}`, {}), look = this._pass(`${COMMON}\n${PIXEL}\n${glsl}\n${FIRST_LOOK}`, {});
    const seen = new THREE.RawShaderMaterial({
      glslVersion: THREE.GLSL3, side: THREE.DoubleSide, blending: THREE.NoBlending, fragmentShader: SEEN,
      vertexShader: VERTEX.replace("DISPLACEMENT", displacement ?? "float displacement(vec2 uv) { return 0.0; }"),
    });
    seen.uniforms = look.uniforms = material.uniforms = values;
    return Object.assign(material, { glsl, seen, look, block: block && this._buffer(block) });
  }

  // Return a uniform block: shaders read many weights from it several times faster than from a texture.
  _buffer(values) {
    const gl = this.renderer.getContext(), buffer = gl.createBuffer();
    gl.bindBuffer(gl.UNIFORM_BUFFER, buffer);
    gl.bufferData(gl.UNIFORM_BUFFER, values, gl.STATIC_DRAW);
    return buffer;
  }
  _bind({ block }) {  // all programs have at most one block, at binding 0
    const gl = this.renderer.getContext();
    if (block) gl.bindBufferBase(gl.UNIFORM_BUFFER, 0, block);
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height);
    this._arranged(true);
  }

  // Arrange the panes anew; if pictures get another size by that, they begin anew, and true is returned.
  _arranged(always = false) {
    if (!this.renderer.domElement.width || this.settings.exposure === undefined) return false;
    const resized = this.arrange();
    if ((!resized && !always) || !this.panes.length) return false;
    this._targets();
    this.restart();
    return true;
  }

  // Return the width and height of a pane over those of the flat picture in it, one of which fills the pane.
  flatMargins(aspect) { const share = aspect / this.shapeOfPane(); return [Math.max(share, 1), Math.max(1 / share, 1)]; }

  // Return {matrix: world to clip, eye, parallel, towardsEye} of a column of this aspect.
  view(aspect) {
    const own = this.settings.view === "picture" ? this.picture(this.settings) : null;
    if (own) {
      const [wide, high] = this.flatMargins(aspect), { zoom, x, y } = this.framing, half = own.half / zoom;
      const camera = new THREE.OrthographicCamera(-half * wide, half * wide, half * high, -half * high, 0.1, 50);
      camera.position.set(own.half * x, own.half * y, 5);
      camera.updateMatrixWorld();
      return { matrix: new THREE.Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse),
        eye: own.eye ?? camera.position, parallel: !own.eye, towardsEye: new THREE.Vector3(0, 0, 1) };
    }
    this.camera.aspect = aspect;
    this.camera.fov = aspect < 1 ? 2 * Math.atan(Math.tan(Math.PI / 12) / aspect) * 180 / Math.PI : 30;
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
    return { matrix: new THREE.Matrix4().multiplyMatrices(this.camera.projectionMatrix, this.camera.matrixWorldInverse),
      eye: this.camera.position, parallel: false, towardsEye: new THREE.Vector3(0, 0, 1) };
  }

  lighting() {
    const own = this.settings.view === "picture" ? this.picture(this.settings) : null;
    return { light: own?.light ?? this.settings.light, lamp: own?.lamp ?? this.lampAt.clone().multiplyScalar(LAMP_DISTANCE), power: own?.power ?? Math.PI * LAMP_DISTANCE ** 2 };
  }

  png() { return this.renderer.domElement; }

  // Return the point that is seen at a place of a pane, {p, n, towards: the direction to the viewer}, or null.
  pick({ fit, x, y, width, height }) {
    if (x < 0 || y < 0 || x >= width || y >= height) return null;
    const { buffer } = this, at = [Math.floor((fit + x / width) / this.fits.length * buffer.width), Math.floor((1 - y / height) * buffer.height)];
    const [place, normal, tangent] = [0, 1, 2].map((which) => {
      const values = new Float32Array(4);
      this.renderer.readRenderTargetPixels(buffer, ...at.map((each) => Math.max(each, 0)), 1, 1, values, undefined, which);
      return values;
    });
    if (!place[3]) return null;
    const p = new THREE.Vector3(...place), n = new THREE.Vector3(...normal).normalize(), view = this.view(width / height);
    const towards = view.parallel ? view.towardsEye.clone() : view.eye.clone().sub(p).normalize();
    if (n.dot(towards) < 0) n.negate();
    return { p, n, t: new THREE.Vector3(...tangent.slice(0, 3)), towards };
  }
}

function halton(index, base) {
  let result = 0;
  for (let f = 1 / base; index > 0; index = Math.floor(index / base), f /= base) result += f * (index % base);
  return result;
}
