// The viewer of light maps: to look around in, flat, lighting spheres, and the photographed ball beside the fit's.
//
// facts: scale, the factor of all arrays; note, a text; of the spheres metal, albedo, specular, silver {roughness} and
// diffuse {roughness}.
// arrays: map [H, W, 3], the fit's radiance over its mean; optional: reference, radiance of the fitted map in this unit.
// pictures: optional: photo, which the fit saw, and ball, which the fit lights, of one size.
// shared: lobes [2, N], the share of light that the lobes of silver and diffuse reflect, by the cosine of the viewer.

// The spheres of metapp.apps.illumination.spheres in one shape, whose first coordinate says which sphere a place is on.
const SPHERES = `
uniform sampler2D lobeAlbedos; uniform float metal, albedo, specular; uniform vec2 alphas;
int kind;
void at_point(vec2 uv) { kind = int(3.0 * uv.x); }  // mirror, silver, diffuse
float alpha_of() { return kind == 1 ? alphas.x : alphas.y; }
float fresnel(float cosine) { float f0 = kind == 2 ? specular : metal; return f0 + (1.0 - f0) * pow(1.0 - cosine, 5.0); }
float masking(float cosine, float alpha) { return 2.0 * cosine / (cosine + sqrt(alpha * alpha + (1.0 - alpha * alpha) * cosine * cosine)); }
void response(vec3 wi, vec3 wo, out vec3 fit, out vec3 reference) {
  float share = fresnel(wo.z), alpha = alpha_of(), value = share;
  if (kind > 0) {
    vec3 h = normalize(wi + wo);
    float square = dot(h.xy / alpha, h.xy / alpha) + h.z * h.z, density = 1.0 / (PI * alpha * alpha * square * square);
    float lost = textureLod(lobeAlbedos, vec2(wo.z, kind == 1 ? 0.25 : 0.75), 0.0).r;
    float lobe = density * masking(wi.z, alpha) * masking(wo.z, alpha) / (4.0 * wo.z * lost);
    value = mix(kind == 2 ? albedo / PI * wi.z : 0.0, lobe, share);
  }
  fit = reference = vec3(value);
}
void first_look(vec3 wo, mat3 frameOf, out vec3 fit, out vec3 reference) {
  float share = fresnel(wo.z);
  vec3 other;
  if (kind == 0) {
    vec2 at = place_of(frameOf * vec3(-wo.xy, wo.z));
    fit = share * mapScale * textureLod(map, at, 0.0).rgb; reference = share * mapScale * textureLod(referenceMap, at, 0.0).rgb;
    return;
  }
  fit = share * lobe_light(vec2(alpha_of()), 0.0, wo, frameOf, reference);
  reference *= share;
  if (kind == 1) return;
  fit += (1.0 - share) * albedo * matte_light(frameOf[2], other);
  reference += (1.0 - share) * albedo * other;
}
Lobes lobes(vec3 wo) {
  float gloss = kind == 1 ? 1.0 : clamp(fresnel(wo.z), 0.1, 0.9);
  return Lobes(vec2(alpha_of()), vec2(1.0), kind == 0 ? vec3(0.0) : vec3(1.0 - gloss, gloss, 0.0), 0.0);
}`;

// Draw a map seen from its middle or flat, or a picture of a ball.
const LOOK = `${SHOWING}
uniform sampler2D photo, ball; uniform int mode, finer; uniform float zoom; uniform vec2 heading;
const float PI = 3.14159265358979;
bool place_at(vec2 px, out vec2 uv) {  // the place in the map that a place in the column shows
  vec2 at = 2.0 * px - column.zw;
  if (mode == 1) {
    uv = 0.5 + vec2(at.x, -at.y) / (2.0 * min(column.z, 2.0 * column.w) * vec2(1.0, 0.5));
    return all(lessThan(abs(uv - 0.5), vec2(0.5)));
  }
  vec3 d = normalize(vec3(at / column.w * zoom, 1.0));  // right, up, ahead
  float c = cos(heading.y), s = sin(heading.y);
  d.yz = vec2(c * d.y + s * d.z, c * d.z - s * d.y);
  uv = vec2(fract(0.5 + (heading.x + atan(d.x, d.z)) / (2.0 * PI)), acos(clamp(d.y, -1.0, 1.0)) / PI);
  return true;
}
float covered;
vec3 map_at(vec2 px) {
  vec2 uv;
  if (!place_at(px, uv)) { covered = 0.0; return paper; }
  covered = 1.0;
  vec3 fit = encoded(textureLod(map, uv, 0.0).rgb * mapScale), reference = encoded(textureLod(referenceMap, uv, 0.0).rgb * mapScale);
  float apart = difference(fit, reference);
  return show == 4 ? vec3(apart) : show == 3 ? heat(apart / full) : is_reference() ? reference : fit;
}
vec3 ball_at(vec2 px, sampler2D picture) {
  vec2 uv = 0.5 + (px - 0.5 * column.zw) / (0.96 * min(column.z, column.w));
  if (distance(uv, vec2(0.5)) > 0.49) return paper;
  vec3 x = textureLod(picture, uv, 0.0).rgb;
  return srgb(min(exposure * mix(x / 12.92, pow((x + 0.055) / 1.055, vec3(2.4)), step(0.04045, x)), 1.0));
}
void main() {
  vec2 px = gl_FragCoord.xy - column.xy;
  vec3 sum = vec3(0.0);
  if (mode == 2) sum = ball_at(px, photo);
  else if (mode == 3) sum = ball_at(px, ball);
  else if (mode < 2) {
    for (int i = 0; i < finer * finer; i++) sum += map_at(px + (vec2(i % finer, i / finer) + 0.5) / float(finer) - 0.5);
    sum /= float(finer * finer);
  } else sum = paper;
  result = vec4(sum, show == 4 ? covered : 1.0);
}`;

// Return spheres [[kind, radius, x, y], ...] as one shape, with the kind in the first coordinate.
function spheres(several) {
  const one = sphere(), count = one.attributes.position.count, geometry = new THREE.BufferGeometry(), index = [];
  for (const [name, { itemSize, array }] of Object.entries(one.attributes)) {
    const values = new Float32Array(several.length * array.length);
    several.forEach(([kind, radius, x, y], k) => {
      for (let i = 0; i < array.length; i++) {
        const place = name === "position" ? radius * array[i] + [x, y, 0][i % 3] : array[i];
        values[k * array.length + i] = name === "uv" ? (kind + 0.5) / 3 : place;
      }
    });
    geometry.setAttribute(name, new THREE.BufferAttribute(values, itemSize));
  }
  several.forEach((each, k) => { for (const i of one.index.array) index.push(i + k * count); });
  geometry.setIndex(index);
  return geometry;
}
Object.assign(SHAPES, {
  spheres: ["Mirror, silver, diffuse", () => spheres([[0, 0.62, 0, 0.62], [1, 0.62, -0.66, -0.5], [2, 0.62, 0.66, -0.5]])],
  mirror: ["Mirror", () => spheres([[0, 1, 0, 0]])],
  silver: ["Silver, matte", () => spheres([[1, 1, 0, 0]])],
  diffuse: ["Plastic, diffuse", () => spheres([[2, 1, 0, 0]])],
});

const DEGREE = Math.PI / 180;

class LightViewer extends ShapeViewer {
  static shapes = ["spheres", "mirror", "silver", "diffuse"];
  static lights = [["map", "The fitted map"]];
  static curve = 2;
  static stops = 10;

  async open() {
    await super.open();
    this.looking = this._pass(LOOK, {
      ...this._shown(), photo: null, ball: null, mode: 0, finer: 1, zoom: 1, heading: new THREE.Vector2(),
    });
    this._look();
  }

  async ownLight() {
    const lights = [];
    for (const fit of this.fits) lights.push(await this._read(fit));
    this.lights = lights;  // assigned at once, since frames are drawn meanwhile
    return lights[0];
  }

  // Return the light of a fit and of its reference, and textures of the photograph and the ball if there are any.
  async _read({ arrays, pictures, facts }) {
    const map = await numbersOf(arrays.map), [height, width] = map.shape, reference = arrays.reference && floatsOf(await numbersOf(arrays.reference));
    const own = { ...lightOf(floatsOf(map), height, width, reference), scale: facts.scale };
    for (const name of ["photo", "ball"].filter((each) => pictures[each])) {
      own[name] = Object.assign(new THREE.Texture(await imageOf(pictures[name])), { ...LINEAR, generateMipmaps: false, needsUpdate: true });
    }
    return own;
  }

  // Return half floats [H, W] as the first channel of a texture.
  _gray({ values, shape }, options) {
    const texels = new Uint16Array(4 * values.length);
    values.forEach((value, i) => { texels[4 * i] = value; });
    return texture(texels, shape[1], shape[0], options);
  }

  close() { this.lights?.forEach(forget); super.close(); }

  lightOf(column) { return this.lights[column]; }
  referenced(fit) { return "reference" in fit.arrays && this.settings.view !== "ball"; }
  picture() { return { half: this.settings.shape === "spheres" ? 1.35 : 1 }; }
  most() { return this.settings.shape === "mirror" ? 64 : super.most(); }
  get inSpace() { return ["free", "picture"].includes(this.settings.view); }

  async material({ facts }) {
    const { metal, albedo, specular, silver, diffuse } = facts, alphas = new THREE.Vector2(silver.roughness ** 2, diffuse.roughness ** 2);
    const lobeAlbedos = this._gray(await shared("lobes"), LINEAR);
    return { glsl: SPHERES, uniforms: { metal, albedo, specular, alphas, lobeAlbedos } };
  }

  controls() {
    const views = [["flat", "Flat map"], ["around", "Panorama"], ["free", "Spheres, to turn"], ["picture", "Spheres from the front"]];
    if (this.fits.some(({ pictures }) => pictures.photo)) views.push(["ball", "The photo's ball and the fit's"]);
    const lit = (s) => ["free", "picture"].includes(s.view);
    const own = {
      view: { value: "flat", options: views }, shape: { label: "Spheres", when: lit }, turn: { when: lit },
    };
    return super.controls().filter(({ name }) => !["environment", "file"].includes(name)).map((each) => ({ ...each, ...own[each.name] }));
  }

  ownControls() {
    const around = (s) => s.view === "around", degrees = (x) => `${Math.round(x)}\u00b0`;
    const notes = this.fits.filter(({ facts }) => facts.note);
    return [
      { name: "heading", label: "Turned to the right", type: "range", min: -180, max: 180, step: 1, value: 0, text: degrees, when: around },
      { name: "pitch", label: "Turned up", type: "range", min: -90, max: 90, step: 1, value: 0, text: degrees, when: around },
      { name: "field", label: "Field of view", type: "range", min: 10, max: 140, step: 1, value: 75, text: degrees, when: around },
      ...notes.map(({ label, facts }, i) => (
        { name: `note${i}`, label: notes.length > 1 ? `${label}: ${facts.note}` : facts.note, type: "note", when: (s) => s.view !== "ball" })),
    ];
  }

  changed(name) {
    if (["heading", "pitch", "field"].includes(name)) this.redraw(); else super.changed(name);
  }

  // Drag to turn, wheel or two fingers to zoom.
  _look() {
    const canvas = this.renderer.domElement, pointers = new Map();
    const zoom = (times) => this.set("field", clamp(this.settings.field * times, 10, 140));
    canvas.addEventListener("pointerdown", (event) => { pointers.set(event.pointerId, event); canvas.setPointerCapture(event.pointerId); });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (this.settings.view !== "around" || !before) return;
      const other = [...pointers.values()].find((each) => each.pointerId !== event.pointerId);
      const apart = (place) => Math.max(Math.hypot(place.clientX - other.clientX, place.clientY - other.clientY), 1);
      pointers.set(event.pointerId, event);
      if (other) return zoom(apart(before) / apart(event));
      const degrees = this.settings.field / this.element.clientHeight;
      this.set("heading", (this.settings.heading - (event.clientX - before.clientX) * degrees + 540) % 360 - 180);
      this.set("pitch", clamp(this.settings.pitch + (event.clientY - before.clientY) * degrees, -90, 90));
    });
    canvas.addEventListener("wheel", (event) => {
      if (this.settings.view !== "around") return;
      event.preventDefault();
      zoom(1.001 ** event.deltaY);
    }, { passive: false });
  }

  // The photograph that a fit saw stands before it.
  parts() {
    const { view } = this.settings, photos = this.fits.flatMap(({ pictures }, fit) => (pictures.photo ? [fit] : []));
    const photo = photos.slice(0, 1).map((fit) => ({ fit, part: "photo", label: "Photo that the fit saw" }));
    const several = this.fits.length > 1;
    if (view === "ball") return [...photo, ...photos.map((fit) => ({ fit, part: "ball", label: `The same ball under the fit's map${several ? `: ${this.fits[fit].label}` : ""}` }))];
    return view === "flat" && ["beside", "all"].includes(this.settings.show) ? [...photo, ...super.parts()] : super.parts();
  }
  shapeOfPane() { return this.settings.view === "flat" ? 2 : 1; }
  finished() { return !this.inSpace || super.finished(); }

  draw() {
    if (this.inSpace) return super.draw();
    this.element.classList.remove("waiting");
    const { settings } = this, u = this.looking.uniforms, { field } = settings;
    u.zoom.value = Math.tan(field / 2 * DEGREE); u.heading.value.set(settings.heading * DEGREE, settings.pitch * DEGREE);
    this._columns(this.looking, (fit, { part, width, height }) => {
      const { size, photo, ball } = this.lights[fit], flat = settings.view === "flat", px = flat ? Math.min(width / 2, height) : height * 180 / field;  // height of the whole map in px
      u.finer.value = clamp(Math.ceil(size.y / px), 1, 4); u.mode.value = { photo: 2, ball: 3 }[part] ?? (flat ? 1 : 0);
      u.photo.value = photo; u.ball.value = ball;
    });
    return false;
  }
}
VIEWERS.light = LightViewer;
