// Shapes of a material in 3D, side by side: camera, lamp, light map, accumulation, wipe between fit and reference, difference.
//
// A subclass of ShapeViewer gives each fit a material: GLSL with
//   void at_point(vec2 uv)                                what depends on the place alone
//   void response(vec3 wi, vec3 wo, out vec3 fit, out vec3 reference)   BRDF times cosine, in the frame of the shape
//   Lobes lobes(vec3 wo)                                  what to sample light from, for a direction to the viewer; without
//                                                         any share it is a perfect mirror, whose response is a reflectance
// and may define
//   #define BENT, mat3 bent()                             the frame that lobes are in, in that of the shape
//   #define UNLIT, void unlit(inout vec3 fit, inout vec3 reference)   radiance that stands for what the light makes
// The frame has z along the shape's normal and x along its tangent. All light is linear RGB.

const LAMP_DISTANCE = 2.414;  // of a lamp under which a white matte surface that faces it has radiance 1
const NODES = 24;             // angles of the viewer that lobes are known at

const COMMON = `
precision highp float; precision highp int; precision highp sampler2D; precision highp sampler3D;
const float PI = 3.14159265358979;
struct Lobes { vec2 first; vec2 second; vec3 shares; float turn; };  // GGX alphas of two lobes; shares of the cosine and of both

uint seed; float draw, stride;  // of a pixel; which frame; by how much of 1 numbers go on from frame to frame
// PCG of the pixel, and from frame to frame a Kronecker sequence, whose mean converges faster: powers of the root of g^6 + g^5 = 1.
float random() {
  seed = seed * 747796405u + 2891336453u;
  uint word = ((seed >> ((seed >> 28u) + 4u)) ^ seed) * 277803737u;
  stride *= 0.88127;
  return fract(float((word >> 22u) ^ word) * (1.0 / 4294967296.0) + draw * stride);
}
vec3 turned(vec3 v, float angle) { float c = cos(angle), s = sin(angle); return vec3(c * v.x - s * v.y, s * v.x + c * v.y, v.z); }
// Visible normals of GGX (Dupuy and Benyoub 2023), and the density of the direction that they mirror the viewer to.
vec3 visible_normal(vec3 v, vec2 alpha, vec2 u) {
  vec3 stretched = normalize(v * vec3(alpha, 1.0));
  float z = (1.0 - u.x) * (1.0 + stretched.z) - stretched.z, radius = sqrt(max(1.0 - z * z, 0.0)), phi = 2.0 * PI * u.y;
  vec3 h = vec3(radius * cos(phi), radius * sin(phi), z) + stretched;
  return normalize(vec3(h.xy * alpha, max(h.z, 1e-6)));
}
float mirrored_density(vec3 v, vec3 l, vec2 alpha) {
  vec3 h = normalize(v + l);
  vec3 scaled = vec3(h.xy / alpha, h.z);
  float square = dot(scaled, scaled), d = 1.0 / (PI * alpha.x * alpha.y * square * square);
  return d / (2.0 * (v.z + length(vec3(alpha * v.xy, v.z))));
}
float lobes_density(Lobes m, vec3 v, vec3 l) {
  if (l.z <= 0.0) return 0.0;
  vec3 v_axes = turned(v, -m.turn), l_axes = turned(l, -m.turn);
  return m.shares.x * l.z / PI + m.shares.y * mirrored_density(v_axes, l_axes, m.first) + m.shares.z * mirrored_density(v_axes, l_axes, m.second);
}
vec3 lobes_sample(Lobes m, vec3 v) {
  float choice = random();
  vec2 u = vec2(random(), random());
  if (choice < m.shares.x) {
    float radius = sqrt(u.x), phi = 2.0 * PI * u.y;
    return vec3(radius * cos(phi), radius * sin(phi), sqrt(1.0 - u.x));
  }
  vec3 viewer = turned(v, -m.turn);
  return turned(reflect(-viewer, visible_normal(viewer, choice < m.shares.x + m.shares.y ? m.first : m.second, u)), m.turn);
}`;

const VERTEX = `
precision highp float; precision highp sampler2D;
// What is seen at each pixel, which is shaded after: shading triangles would pay for all that lies behind others, and for the
// quads at their edges.
in vec3 position; in vec3 normal; in vec3 tangent; in vec2 uv;
uniform mat4 toClip; uniform vec2 jitter;
out vec3 P; out vec3 N; out vec3 T; out vec2 U;
DISPLACEMENT
void main() {
  P = position + normal * displacement(uv); N = normal; T = tangent; U = uv;
  gl_Position = toClip * vec4(P, 1.0);
  gl_Position.xy += jitter * gl_Position.w;
}`;

const SEEN = `
precision highp float;
in vec3 P; in vec3 N; in vec3 T; in vec2 U;
layout(location = 0) out vec4 place; layout(location = 1) out vec4 normalOut; layout(location = 2) out vec4 tangentOut;
void main() { place = vec4(P, 1.0); normalOut = vec4(N, U.x); tangentOut = vec4(T, U.y); }`;

const FRAGMENT = `
uniform sampler2D seen0, seen1, seen2;
vec3 P, N, T; vec2 U;
layout(location = 0) out vec4 fitOut; layout(location = 1) out vec4 referenceOut;
uniform vec3 eye; uniform vec3 towardsEye; uniform bool parallel;
uniform int light, frame, chunks; uniform vec3 lamp; uniform float flashPower;
uniform sampler2D map, referenceMap, places, studio; uniform vec2 mapSize; uniform float mapTotal, mapScale, mapTurn;

#ifndef BENT
mat3 bent() { return mat3(1.0); }
#endif
#ifndef UNLIT
void unlit(inout vec3 fit, inout vec3 reference) {}
#endif
// Light maps as metapp.appearance.latlong has them: u = atan2(x, -z) / 2 pi, v = acos(y) / pi.
vec2 place_of(vec3 d) { return vec2(fract(atan(d.x, -d.z) / (2.0 * PI) - mapTurn), acos(clamp(d.y, -1.0, 1.0)) / PI); }
float map_density(vec2 at) { return textureLod(map, at, 0.0).a / (mapTotal * max(sin(PI * at.y), 1e-4)); }  // of samples: luminance
float tent(float u) { float t = 2.0 * u - 1.0; return sign(t) * (1.0 - sqrt(1.0 - abs(t))); }
vec3 map_sample() {  // around a texel as radiance is interpolated, so that one bright texel among dark ones is no noise
  int count = textureSize(places, 0).x;
  vec2 texel = texelFetch(places, ivec2(min(int(random() * float(count)), count - 1), 0), 0).xy;
  float phi = 2.0 * PI * ((texel.x + 0.5 + tent(random())) / mapSize.x + mapTurn), theta = PI * (texel.y + 0.5 + tent(random())) / mapSize.y;
  float radius = abs(sin(theta));  // beyond a pole it is mirrored there
  return vec3(radius * sin(phi), cos(theta), -radius * cos(phi));
}
// Light from one direction in the frame of the shape, and what a response to it counts.
vec3 by_lamp(mat3 frameOf, out vec3 weight) {
  vec3 towards = lamp - P;
  weight = vec3(flashPower / dot(towards, towards));
  return normalize(towards) * frameOf;
}
vec3 by_map(vec3 wo, mat3 frameOf, out vec3 weight, out vec3 other) {  // one sample of either strategy, balance heuristic
  mat3 axes = bent();
  vec3 viewer = wo * axes;
  viewer = normalize(vec3(viewer.xy, max(viewer.z, 1e-3)));
  Lobes mixture = lobes(viewer);
  bool perfect = mixture.shares == vec3(0.0);
  vec3 wi = perfect ? vec3(-wo.xy, wo.z) : random() < 0.5 ? map_sample() * frameOf : axes * lobes_sample(mixture, viewer);
  vec2 at = place_of(frameOf * wi);
  float scale = mapScale / (perfect ? 1.0 : 0.5 * map_density(at) + 0.5 * lobes_density(mixture, viewer, wi * axes));
  weight = textureLod(map, at, 0.0).rgb * scale;
  other = textureLod(referenceMap, at, 0.0).rgb * scale;
  return wi;
}
// The lights of metapp's pictures of BRDFs, some in each frame: row 0 holds directions, row 1 irradiance; of the rings about
// each normal row 0 holds half vectors in the frame of the shape, row 1 a solid angle and in its fourth number 1.
vec3 by_studio(int i, vec3 wo, mat3 frameOf, out vec3 weight) {
  vec4 where = texelFetch(studio, ivec2(i, 0), 0), power = texelFetch(studio, ivec2(i, 1), 0);
  weight = power.rgb * float(chunks);
  if (power.a < 0.5) return where.xyz * frameOf;
  float cosine = max(dot(wo, where.xyz), 0.0);
  vec3 wi = 2.0 * cosine * where.xyz - wo;
  weight *= 4.0 * cosine * (0.06 + 0.05 * (frameOf * wi).y);
  return wi;
}
void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec4 place = texelFetch(seen0, pixel, 0), first_two = texelFetch(seen1, pixel, 0), last_two = texelFetch(seen2, pixel, 0);
  fitOut = referenceOut = vec4(0.0);
  if (place.w == 0.0) return;
  P = place.xyz; N = first_two.xyz; T = last_two.xyz; U = vec2(first_two.w, last_two.w);
  seed = uint(gl_FragCoord.x) * 1973u + uint(gl_FragCoord.y) * 9277u + 1u;
  random(); random();
  draw = float(frame); stride = 1.0;
  vec3 towards = parallel ? towardsEye : normalize(eye - P);
  vec3 n = normalize(N);
  if (dot(n, towards) < 0.0) n = -n;
  vec3 t = normalize(T - n * dot(n, T));
  mat3 frameOf = mat3(t, cross(n, t), n);
  vec3 wo = towards * frameOf;
  wo = normalize(vec3(wo.xy, max(wo.z, 1e-3)));
  vec3 fit = vec3(0.0), reference = vec3(0.0), a, b, weight, other;
  at_point(U);
  int first = 0, last = 1;
  if (light == 2) {
    int count = textureSize(studio, 0).x, each = (count + chunks - 1) / chunks;
    first = (frame % chunks) * each; last = min(first + each, count);
  }
  for (int i = first; i < last; i++) {  // one call of response, which may be long
    vec3 wi = light == 0 ? by_lamp(frameOf, weight) : light == 1 ? by_map(wo, frameOf, weight, other) : by_studio(i, wo, frameOf, weight);
    if (light != 1) other = weight;
    if (wi.z <= 1e-4) continue;
    response(wi, wo, a, b);
    fit += a * weight; reference += b * other;
  }
  unlit(fit, reference);
  if (any(isnan(fit)) || any(isinf(fit))) fit = vec3(0.0);
  if (any(isnan(reference)) || any(isinf(reference))) reference = vec3(0.0);
  fitOut = vec4(fit, 1.0); referenceOut = vec4(reference, 1.0);
}`;

const WHOLE = `precision highp float; in vec3 position; void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }`;
const ADD = `
precision highp float; precision highp sampler2D;
uniform sampler2D a0, a1, b0, b1; uniform float keep;
layout(location = 0) out vec4 first; layout(location = 1) out vec4 second;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  first = keep * texelFetch(a0, at, 0) + texelFetch(b0, at, 0);
  second = keep * texelFetch(a1, at, 0) + texelFetch(b1, at, 0);
}`;
// What puts fit and reference on the screen, in a column of it: [left, bottom, width, height], px.
const SHOWING = `
precision highp float; precision highp int; precision highp sampler2D;
uniform float exposure, gain, wipe, mapScale; uniform int curve, show; uniform vec4 column; uniform vec3 paper;
uniform sampler2D map, referenceMap;
out vec4 result;
vec3 srgb(vec3 x) { return mix(12.92 * x, 1.055 * pow(max(x, 0.0031308), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, x)); }
vec3 encoded(vec3 x) {  // the curves of metapp's PNGs
  x = max(x * exposure, 0.0);
  if (curve == 1) return pow(clamp(x, 1e-6, 1.0), vec3(1.0 / 2.2));
  return srgb(curve == 2 ? x / (1.0 + x) : min(x, 1.0));
}
bool is_reference() { return show == 1 || (show == 2 && gl_FragCoord.x - column.x < wipe * column.z); }`;
const DISPLAY = `${SHOWING}
uniform sampler2D fit, reference; uniform float samples, scale, mapTurn;
uniform bool mapBehind, parallel; uniform mat4 fromClip; uniform vec3 eye;
vec4 shown(sampler2D sum) {
  vec4 v = texelFetch(sum, ivec2(gl_FragCoord.xy * scale), 0);
  return v.a > 0.0 ? vec4(encoded(v.rgb / v.a), v.a / samples) : vec4(0.0);
}
vec3 behind() {
  if (!mapBehind || parallel) return paper;
  vec4 far = fromClip * vec4((gl_FragCoord.xy - column.xy) / column.zw * 2.0 - 1.0, 1.0, 1.0);
  vec3 d = normalize(far.xyz / far.w - eye);
  vec2 at = vec2(fract(atan(d.x, -d.z) / 6.28318530718 - mapTurn), acos(clamp(d.y, -1.0, 1.0)) / 3.14159265359);
  return encoded((is_reference() ? textureLod(referenceMap, at, 0.0) : textureLod(map, at, 0.0)).rgb * mapScale);
}
void main() {
  vec4 a = shown(fit), b = shown(reference);
  if (show == 3) { result = vec4(mix(paper, abs(a.rgb - b.rgb) * gain, a.a), 1.0); return; }
  vec4 chosen = is_reference() ? b : a;
  result = vec4(mix(behind(), chosen.rgb, chosen.a), 1.0);
}`;

THREE.ColorManagement.enabled = false;
const LINEAR = { minFilter: THREE.LinearFilter, magFilter: THREE.LinearFilter };
const NEAREST = { minFilter: THREE.NearestFilter, magFilter: THREE.NearestFilter };

// A texture of numbers, four a texel.
function texture(values, width, height, options = {}) {
  const half = values instanceof Uint16Array;
  const made = new THREE.DataTexture(values, width, height, THREE.RGBAFormat, half ? THREE.HalfFloatType : THREE.FloatType);
  Object.assign(made, { ...NEAREST, ...options, needsUpdate: true });
  return made;
}

// A light map [H, W, 3] for shaders: radiance, in the fourth channel luminance times the sine of the polar angle;
// and places drawn by that over the map. Where the reference has a light of its own, the luminance is the mean of both.
function lightOf(values, height, width, reference = values) {
  const half = (x) => THREE.DataUtils.toHalfFloat(clamp(x, 0, 65504));
  const sums = new Float64Array(height * width), [texels, others] = [0, 1].map(() => new Uint16Array(4 * height * width));
  let total = 0;
  for (let i = 0; i < height * width; i++) {
    const row = Math.floor(i / width);
    const solidAngle = (Math.cos(Math.PI * row / height) - Math.cos(Math.PI * (row + 1) / height)) * 2 * Math.PI / width;
    let luminance = 1e-6;
    for (let c = 0; c < 3; c++) {
      texels[4 * i + c] = half(values[3 * i + c]);
      others[4 * i + c] = half(reference[3 * i + c]);
      luminance += [0.2126, 0.7152, 0.0722][c] * (clamp(values[3 * i + c], 0, 65504) + clamp(reference[3 * i + c], 0, 65504)) / 2;
    }
    texels[4 * i + 3] = half(luminance * solidAngle * height * width / (2 * Math.PI ** 2));
    sums[i] = total += luminance * solidAngle;
  }
  const places = new Float32Array(4 * 8192);
  for (let i = 0, at = 0; i < 8192; i++) {
    while (sums[at] < (i + 0.5) / 8192 * total && at < sums.length - 1) at++;
    places[4 * i] = at % width; places[4 * i + 1] = Math.floor(at / width);
  }
  const mean = total / (4 * Math.PI), around = { ...LINEAR, wrapS: THREE.RepeatWrapping }, map = texture(texels, width, height, around);
  return { map, reference: reference === values ? map : texture(others, width, height, around), places: texture(places, 8192, 1),
    size: new THREE.Vector2(width, height), total, scale: 0.5 / mean };
}

// Gives up the textures of a light.
function forget(light) { Object.values(light).forEach((part) => { if (part?.isTexture) part.dispose(); }); }

// A grid of [u, v] in [0, 1] on a surface, with normals and tangents by differences.
function parametric(place, across, down) {
  const count = (across + 1) * (down + 1), arrays = { position: [3], normal: [3], tangent: [3], uv: [2] };
  for (const [name, [size]] of Object.entries(arrays)) arrays[name] = new THREE.BufferAttribute(new Float32Array(count * size), size);
  const point = (u, v) => new THREE.Vector3(...place(u, v)), step = 1e-3;
  for (let j = 0, k = 0; j <= down; j++) {
    for (let i = 0; i <= across; i++, k++) {
      const u = i / across, v = j / down, inner = clamp(v, step * 2, 1 - step * 2);
      const along = point(u + step, inner).sub(point(u - step, inner)).normalize();
      const up = point(u, inner + step).sub(point(u, inner - step));
      const normal = new THREE.Vector3().crossVectors(along, up).normalize();
      arrays.position.setXYZ(k, ...place(u, v));
      arrays.normal.setXYZ(k, normal.x, normal.y, normal.z);
      arrays.tangent.setXYZ(k, along.x, along.y, along.z);
      arrays.uv.setXY(k, u, v);
    }
  }
  const index = [];
  for (let j = 0; j < down; j++) {
    for (let i = 0; i < across; i++) {
      const a = j * (across + 1) + i, b = a + across + 1;
      index.push(a, a + 1, b, b, a + 1, b + 1);
    }
  }
  const geometry = new THREE.BufferGeometry();
  for (const [name, attribute] of Object.entries(arrays)) geometry.setAttribute(name, attribute);
  geometry.setIndex(index);
  return geometry;
}

function sphere() {  // exact normals; tangents lie horizontally, as in metapp's pictures
  const made = parametric((u, v) => {
    const phi = 2 * Math.PI * u, theta = Math.PI * (1 - v);
    return [Math.sin(theta) * Math.sin(phi), Math.cos(theta), Math.sin(theta) * Math.cos(phi)];
  }, 192, 96);
  const { position, normal, tangent } = made.attributes;
  normal.array.set(position.array);
  for (let k = 0; k < position.count; k++) {
    const x = position.getX(k), z = position.getZ(k), length = Math.hypot(x, z) || 1;
    tangent.setXYZ(k, z / length || 1, 0, -x / length);
  }
  return made;
}

const SHAPES = {
  sphere: ["Sphere", sphere],
  plane: ["Plane", () => parametric((u, v) => [2 * u - 1, 2 * v - 1, 0], 256, 256)],
  cylinder: ["Cylinder", () => parametric((u, v) => [0.7 * Math.sin(2 * Math.PI * u), 2 * v - 1, 0.7 * Math.cos(2 * Math.PI * u)], 256, 256)],
  cloth: ["Draped cloth", () => parametric((u, v) => {
    const x = 2.4 * u - 1.2, y = 2.4 * v - 1.2, r = Math.hypot(x, y);
    const over = r < 0.6 ? Math.sqrt(1 - r * r) : Math.max(0.8 - 0.75 * (r - 0.6), -0.1);
    const fold = clamp((r - 0.5) / 0.6, 0, 1) ** 2 * 0.16 * Math.cos(9 * Math.atan2(y, x));
    return [x, y, over + fold - 0.4];
  }, 256, 256)],
  knot: ["Bent tube", () => parametric((u, v) => {
    const t = 2 * Math.PI * u, around = 2 * Math.PI * v;
    const centre = (a) => [0.5 * (Math.sin(a) + 2 * Math.sin(2 * a)) * 0.55, 0.5 * (Math.cos(a) - 2 * Math.cos(2 * a)) * 0.55, -0.4 * Math.sin(3 * a)];
    const at = new THREE.Vector3(...centre(t)), ahead = new THREE.Vector3(...centre(t + 1e-3)).sub(at).normalize();
    const side = new THREE.Vector3(0.1, 0.2, 1).cross(ahead).normalize(), up = new THREE.Vector3().crossVectors(ahead, side);
    at.addScaledVector(side, 0.26 * Math.cos(around)).addScaledVector(up, 0.26 * Math.sin(around));
    return at.toArray();
  }, 384, 48)],
};
const builtShapes = {};
const shapeOf = (name) => (builtShapes[name] ??= SHAPES[name][1]());

class ShapeViewer extends Viewer {
  // What subclasses change.
  static shapes = ["sphere", "plane", "knot"];
  static lights = [["lamp", "Lamp"], ["map", "Light map"]];
  static curve = 0;  // of `encoded`
  static stops = 6;  // of exposure, either way
  async material(fit) { throw new Error("no material"); }  // -> {glsl, displacement, uniforms}
  referenced(fit) { return false; }  // whether there is a reference to compare with
  picture(settings) { return null; }  // where metapp's own picture is looked at: {lamp, eye, half: of an orthographic view}

  async open() {
    this.renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true, powerPreference: "high-performance" });
    if (!this.renderer.extensions.has("EXT_color_buffer_float")) throw new Error("WebGL 2 lacks EXT_color_buffer_float here");
    this.renderer.domElement.addEventListener("webglcontextlost", () => this.lost?.());
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    this.renderer.autoClear = false;
    this.renderer.debug.onShaderError = (gl, program, vertex, fragment) => { throw new Error(gl.getShaderInfoLog(fragment) || gl.getShaderInfoLog(vertex)); };
    this.element.append(this.renderer.domElement);
    this.camera = new THREE.PerspectiveCamera(30, 1, 0.1, 50);
    this.camera.position.set(0, 0, 5);
    this.orbit = new THREE.OrbitControls(this.camera, this.renderer.domElement);
    this.orbit.enablePan = false;
    this.orbit.addEventListener("change", () => this.restart());
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
      ...this._shown(), fit: null, reference: null, samples: 1, scale: 1,
      mapBehind: false, parallel: false, fromClip: new THREE.Matrix4(), eye: new THREE.Vector3(), mapTurn: 0,
    });
    this.light = await this.ownLight();
    this.materials = [];
    for (const fit of this.fits) this.materials.push(this._made(await this.material(fit)));
    this.count = 0; this.detail = 0.25; this.cost = 0; this.moves = false; this.settings = {};
    this._overlays();
    this._pointers();
  }

  async ownLight() {
    const array = await shared("light");
    return lightOf(floatsOf(array), ...array.shape.slice(0, 2));
  }

  controls() {
    const { shapes, lights, stops } = this.constructor, compared = () => this.fits.some((fit) => this.referenced(fit));
    const own = this.picture({}) !== null;
    return [
      { name: "view", label: "View", type: "choice", value: "free", options: [["free", "Free"], ["picture", "As in metapp's picture"]], when: () => own },
      { name: "shape", label: "Shape", type: "choice", value: shapes[0], options: shapes.map((name) => [name, SHAPES[name][0]]), when: (s) => s.view === "free" },
      { name: "light", label: "Light", type: "choice", value: lights[0][0], options: lights, when: (s) => lights.length > 1 && s.view === "free" },
      { name: "turn", label: "Rotation of the light map", type: "range", min: 0, max: 360, step: 1, value: 0, text: (x) => `${x}\u00b0`, when: (s) => s.light === "map" && s.view === "free" },
      { name: "behind", label: "Show the light map", type: "check", value: false, when: (s) => s.light === "map" && s.view === "free" },
      { name: "file", label: "Another light map (.hdr)", type: "file", accept: ".hdr", run: (file) => this.readLight(file), when: (s) => s.light === "map" && s.view === "free" },
      { name: "show", label: "Show", type: "choice", value: "fit", when: compared,
        options: [["fit", "Fit"], ["reference", "Reference"], ["wipe", "Reference | fit"], ["difference", "Difference"]] },
      { name: "wipe", label: "Wipe", type: "range", min: 0, max: 1, step: 0.005, value: 0.5, text: (x) => `${Math.round(100 * x)} %`, when: (s) => s.show === "wipe" && compared() },
      { name: "gain", label: "Difference times", type: "range", min: 1, max: 50, step: 1, value: 5, when: (s) => s.show === "difference" && compared() },
      { name: "exposure", label: "Exposure", type: "range", min: -stops, max: stops, step: 0.1, value: 0, text: (x) => `${x > 0 ? "+" : ""}${x.toFixed(1)} stops` },
      { name: "paper", label: "Background", type: "choice", value: "dark", options: [["dark", "Dark"], ["gray", "Gray"], ["white", "White"]] },
      ...this.ownControls(),
    ];
  }
  ownControls() { return []; }

  async readLight(file) {
    let read;
    try { read = new THREE.HDRLoader().parse(await file.arrayBuffer()); } catch (error) { return say(`${file.name} is no light map of Radiance (.hdr): ${error.message}`); }
    const { data, width, height } = read, before = this.light;
    const values = new Float32Array(3 * width * height), float = data instanceof Uint16Array ? fromHalf : (x) => x;
    for (let i = 0; i < width * height; i++) for (let c = 0; c < 3; c++) values[3 * i + c] = float(data[4 * i + c]);
    this.light = lightOf(values, height, width);
    forget(before);
    say(`Light map: ${file.name}`);
    this.restart();
  }

  changed(name) {
    if (name === "shape" || name === "view") this.mesh.geometry = shapeOf(this.shape());
    if (["wipe", "gain", "exposure", "paper", "show"].includes(name)) this.redraw(); else this.restart();
    this._place();
  }

  shape() { return (this.settings.view === "picture" && this.picture(this.settings)?.shape) || this.settings.shape || this.constructor.shapes[0]; }
  restart() { this.count = 0; this.redraw(); this._place(); }

  async update(group) {
    await super.update(group);
    const made = [];
    for (const fit of this.fits) made.push(this._made(await this.material(fit)));
    this.materials.forEach((each) => this._free(each));
    this.materials = made;
    this.restart();
  }

  _free(material) {
    Object.values(material.uniforms).forEach((each) => { if (each.value?.isTexture && each.own) each.value.dispose(); });
    if (material.block) this.renderer.getContext().deleteBuffer(material.block);
    [material.seen, material.evaluator].forEach((each) => each?.dispose());
    material.dispose();
  }

  close() {
    this.orbit?.dispose();
    this.materials?.forEach((each) => this._free(each));
    [...(this.targets ?? []), this.buffer].forEach((each) => each?.dispose());
    Object.values(builtShapes).forEach((each) => each.dispose());  // each knows all that drew it
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
      mapSize: new THREE.Vector2(), mapTotal: 1, mapScale: 1, mapTurn: 0, seen0: null, seen1: null, seen2: null,
    };
    const values = Object.fromEntries(Object.entries(own).map(([name, value]) => [name, { value }]));
    for (const [name, value] of Object.entries(uniforms)) values[name] = { value, own: true };
    const material = this._pass(`${COMMON}\n${glsl}\n${FRAGMENT}`, {});
    const seen = new THREE.RawShaderMaterial({
      glslVersion: THREE.GLSL3, side: THREE.DoubleSide, blending: THREE.NoBlending, fragmentShader: SEEN,
      vertexShader: VERTEX.replace("DISPLACEMENT", displacement ?? "float displacement(vec2 uv) { return 0.0; }"),
    });
    seen.uniforms = material.uniforms = values;
    return Object.assign(material, { glsl, seen, block: block && this._buffer(block) });
  }

  // A uniform block: shaders read many weights from one several times faster than from a texture.
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
    this._targets();
    this.restart();
  }

  _targets() {
    const size = this.renderer.getDrawingBufferSize(new THREE.Vector2()).multiplyScalar(this.detail).ceil();
    [...(this.targets ?? []), this.buffer].forEach((each) => each?.dispose());
    const options = { count: 2, type: THREE.FloatType, format: THREE.RGBAFormat, ...NEAREST, depthBuffer: false, generateMipmaps: false };
    this.targets = [0, 1, 2].map(() => new THREE.WebGLRenderTarget(size.x, size.y, options));
    this.buffer = new THREE.WebGLRenderTarget(size.x, size.y, { ...options, count: 3, depthBuffer: true });
  }

  // How many pixels are worth their time: fewer while something moves; half as many across at rest where a frame takes seconds.
  moving(on) {
    this.moves = on;
    this._adapt();
  }
  _adapt() {
    let wanted = this.detail === 0.5 && this.cost > 2000 || this.cost > 4000 ? 0.5 : 1;  // between them as it is: each change begins anew
    if (!this.cost) wanted = 0.25;
    else if (this.moves) wanted = clamp(Math.sqrt(70 / this.cost), 0.15, 1);
    if (wanted === this.detail || (this.moves && wanted < 1 && Math.abs(wanted - this.detail) < 0.15 * this.detail)) return;
    this.detail = wanted;
    this._targets();
    this.restart();
  }

  // -> {matrix: world to clip, eye, parallel, towardsEye} of a column of this aspect.
  view(aspect) {
    const own = this.settings.view === "picture" ? this.picture(this.settings) : null;
    if (own) {
      const wide = Math.max(aspect, 1), high = Math.max(1 / aspect, 1), half = own.half;
      const camera = new THREE.OrthographicCamera(-half * wide, half * wide, half * high, -half * high, 0.1, 50);
      camera.position.set(0, 0, 5);
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

  most() { return { lamp: 16, map: 1024, studio: 4 * this.chunks }[this.lighting().light]; }  // frames of a picture
  get chunks() { return 8; }

  draw() {
    const begin = performance.now(), { renderer } = this, whole = this.targets[0], columns = this.fits.length;
    const measured = this.count < this.most();
    if (measured) {
      const width = whole.width / columns, view = this.view(width / whole.height), { light, lamp, power } = this.lighting();
      const shift = light === "studio" ? Math.floor(this.count / this.chunks) : this.count;
      const jitter = [halton(shift + 1, 2) - 0.5, halton(shift + 1, 3) - 0.5];
      const [sample, before, after] = [whole, this.targets[1 + (this.count & 1)], this.targets[2 - (this.count & 1)]];
      renderer.setClearColor(0, 0);
      renderer.setRenderTarget(this.buffer);
      renderer.clear();
      this.materials.forEach((material, i) => {
        const u = material.uniforms, left = Math.round(i * width), right = Math.round((i + 1) * width);
        u.toClip.value = view.matrix; u.eye.value = view.eye; u.parallel.value = view.parallel; u.towardsEye.value = view.towardsEye;
        u.jitter.value.set(2 * jitter[0] / (right - left), 2 * jitter[1] / whole.height);
        u.light.value = { lamp: 0, map: 1, studio: 2 }[light]; u.frame.value = this.count; u.chunks.value = this.chunks;
        u.lamp.value = lamp; u.flashPower.value = power; u.studio.value = this.studio ?? null;
        const own = this.lightOf(i);
        u.map.value = own.map; u.referenceMap.value = own.reference; u.places.value = own.places; u.mapSize.value = own.size; u.mapTotal.value = own.total;
        u.mapScale.value = own.scale; u.mapTurn.value = this.settings.turn / 360;
        this.beforeDraw(u, i);
        for (const target of [this.buffer, sample]) target.viewport.set(left, 0, right - left, whole.height);
        this.mesh.material = material.seen;
        renderer.setRenderTarget(this.buffer);
        renderer.render(this.scene, this.camera);
        this.buffer.textures.forEach((each, k) => { u[`seen${k}`].value = each; });
        this._bind(material);
        this._fill(material, sample);
      });
      Object.entries({ a0: before.textures[0], a1: before.textures[1], b0: sample.textures[0], b1: sample.textures[1], keep: this.count ? 1 : 0 })
        .forEach(([name, value]) => { this.adding.uniforms[name].value = value; });
      this._fill(this.adding, after);
      this.count += 1;
      this.sum = after;
    }
    this._show();
    renderer.getContext().readPixels(0, 0, 1, 1, 0x1908, 0x1401, new Uint8Array(4));  // waits until all is drawn
    if (measured) {
      const cost = (performance.now() - begin) / this.detail ** 2;
      if (!this.compiled) this.compiled = true;  // the first frame compiles: its time says nothing
      else { this.cost = this.cost ? 0.7 * this.cost + 0.3 * cost : cost; this._adapt(); }
    }
    return this.count < this.most();
  }
  lightOf(column) { return this.light; }
  beforeDraw(uniforms, column) {}

  _fill(material, target) {
    this.whole.material = material;
    this.renderer.setRenderTarget(target);
    this.renderer.render(this.wholeScene, this.camera);
  }

  _show() {
    const { renderer, settings } = this, u = this.showing.uniforms, size = renderer.getDrawingBufferSize(new THREE.Vector2());
    const view = this.view(size.x / this.fits.length / size.y);
    u.fit.value = this.sum.textures[0]; u.reference.value = this.sum.textures[1]; u.samples.value = this.count; u.scale.value = this.detail;
    u.mapBehind.value = settings.behind && this.lighting().light === "map"; u.parallel.value = view.parallel; u.eye.value = view.eye;
    u.fromClip.value = view.matrix.clone().invert(); u.mapTurn.value = settings.turn / 360;
    this._columns(this.showing);
  }

  // Uniforms of SHOWING, and its pass over the columns; `each(i)` sets what else a column needs.
  _shown() {
    return { map: null, referenceMap: null, exposure: 1, gain: 1, wipe: 0.5, curve: 0, show: 0, mapScale: 1, column: new THREE.Vector4(), paper: new THREE.Vector3() };
  }
  _columns(material, each = () => {}) {
    const { renderer, settings } = this, u = material.uniforms, size = renderer.getDrawingBufferSize(new THREE.Vector2());
    const ratio = renderer.getPixelRatio(), width = size.x / this.fits.length;
    u.exposure.value = 2 ** settings.exposure; u.gain.value = settings.gain; u.wipe.value = settings.wipe; u.curve.value = this.constructor.curve;
    u.paper.value.setScalar({ dark: 0.09, gray: 0.5, white: 1 }[settings.paper]);
    renderer.setRenderTarget(null);
    renderer.setScissorTest(true);
    this.fits.forEach((fit, i) => {
      const left = Math.round(i * width), right = Math.round((i + 1) * width), own = this.lightOf(i);
      u.column.value.set(left, 0, right - left, size.y);
      u.map.value = own.map; u.referenceMap.value = own.reference; u.mapScale.value = own.scale;
      u.show.value = this.referenced(fit) ? { fit: 0, reference: 1, wipe: 2, difference: 3 }[settings.show] : 0;
      each(i);
      renderer.setScissor(left / ratio, 0, (right - left) / ratio, size.y / ratio);
      this._fill(material, null);
    });
    renderer.setScissorTest(false);
  }

  png() { return this.renderer.domElement; }

  // Labels, wipes and lamps that lie over each column.
  _overlays() {
    this.overlays = this.fits.map((fit, i) => {
      const label = make("div", { className: "label" }), lamp = make("button", { type: "button", className: "lamp", title: "Drag the lamp" });
      const wipe = make("div", { className: "wipe" });
      this.element.append(label, lamp, wipe);
      this._drag(lamp, (event) => this._lampTo(event, i));
      this._drag(wipe, (event) => {
        const { x, width } = this.columnAt(event);
        this.set("wipe", clamp(x / width, 0, 1));
      });
      return { label, lamp, wipe };
    });
  }

  _drag(element, move) {
    element.addEventListener("pointerdown", (event) => { element.setPointerCapture(event.pointerId); this.moving(true); event.preventDefault(); });
    element.addEventListener("pointermove", (event) => { if (element.hasPointerCapture(event.pointerId)) move(event); });
    element.addEventListener("lostpointercapture", () => this.moving(false));
  }

  _pointers() {
    const canvas = this.renderer.domElement;
    canvas.addEventListener("pointerdown", () => this.moving(true));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => this.moving(false));
    canvas.addEventListener("pointermove", (event) => { if (!event.buttons) this.pointed?.(this.columnAt(event)); });
  }

  // The lamp's handle: its angle from the line of sight grows with the distance from the middle, so that all directions are within reach.
  _lampTo(event, column) {
    const box = this.element.getBoundingClientRect(), width = box.width / this.fits.length, half = Math.min(width, box.height) * 0.46;
    const x = (event.clientX - box.left - (column + 0.5) * width) / half, y = -(event.clientY - box.top - box.height / 2) / half;
    const radius = Math.min(Math.hypot(x, y), 1.41), cosine = 1 - radius * radius, sine = Math.sqrt(Math.max(1 - cosine * cosine, 0));
    const angle = Math.atan2(y, x), own = new THREE.Vector3(sine * Math.cos(angle), sine * Math.sin(angle), cosine);
    this.lampAt.copy(own.transformDirection(this.camera.matrixWorld));
    this.restart();
  }

  _place() {
    if (!this.overlays) return;
    const { clientWidth, clientHeight } = this.element, width = clientWidth / this.fits.length, half = Math.min(width, clientHeight) * 0.46;
    const lamp = this.lampAt.clone().transformDirection(this.camera.matrixWorldInverse.copy(this.camera.matrixWorld).invert());
    const radius = Math.sqrt(Math.max(1 - lamp.z, 0)), flat = Math.hypot(lamp.x, lamp.y) || 1;
    this.overlays.forEach((each, i) => {
      const lit = this.settings.light === "lamp" && this.settings.view === "free", left = i * width;
      each.lamp.hidden = !lit;
      each.lamp.classList.toggle("behind", lamp.z < 0);
      each.lamp.style.left = `${left + width / 2 + half * radius * lamp.x / flat}px`;
      each.lamp.style.top = `${clientHeight / 2 - half * radius * lamp.y / flat}px`;
      each.wipe.hidden = this.settings.show !== "wipe" || !this.referenced(this.fits[i]);
      each.wipe.style.left = `${left + width * this.settings.wipe}px`;
      each.label.style.left = `${left + 8}px`;
      const { label, caption } = this.fits[i];
      each.label.hidden = this.fits.length < 2;
      each.label.textContent = `${label}${caption ? `: ${caption}` : ""}`;
    });
  }

  // What is seen at a place of a column: {p, n, towards: to the viewer}, or null.
  pick({ column, x, y, width, height }) {
    const { buffer } = this, at = [Math.floor((column + x / width) / this.fits.length * buffer.width), Math.floor((1 - y / height) * buffer.height)];
    const [place, normal] = [0, 1].map((which) => {
      const values = new Float32Array(4);
      this.renderer.readRenderTargetPixels(buffer, ...at.map((each) => Math.max(each, 0)), 1, 1, values, undefined, which);
      return values;
    });
    if (!place[3]) return null;
    const p = new THREE.Vector3(...place), n = new THREE.Vector3(...normal).normalize(), view = this.view(width / height);
    const towards = view.parallel ? view.towardsEye.clone() : view.eye.clone().sub(p).normalize();
    if (n.dot(towards) < 0) n.negate();
    return { p, n, towards };
  }
}

function halton(index, base) {
  let result = 0;
  for (let f = 1 / base; index > 0; index = Math.floor(index / base), f /= base) result += f * (index % base);
  return result;
}
