// The viewer of BRDFs: it evaluates the fitted network in the fragment shader, on shapes, and draws a polar plot below the
// pointer.
//
// facts: network ("nbrdf", "featured" or "anisotropic"), inputs, hidden, smoothing (AZIMUTH_ONSET_RAD2, VECTOR_SMOOTHING
// and COSINE_SMOOTHING of metapp.apps.brdf.feature_network), turn, darkest, alphas [[2], [2]] of the lobes.
// arrays: weights [N, 4], laid out by metapp.extensions.viewer.pages.brdf.pack_layers; shares [24, 3] of the lobes;
// optional: residual [phi_d, theta_d, theta_h, 4], log(1 + f) of the samples less that of the fit (phi_d in [0, 2 pi), or
// in [0, pi) if the fit is reciprocal; theta_h by its square root), or with phi_h the axes of
// metapp.extensions.viewer.pages.anisotropic_residual; samples [N, 6 or 7]: theta_h, theta_d, phi_d, phi_h if any, RGB.
// shared: light, a lat-long map [H, W, 3]; studio [2, L, 4], the lights of metapp's pictures.

const DRAWN = 128;       // number of directions over which albedos of lobes are averaged
const HALF_CIRCLE = 24;  // number of cells of phi_d from 0 to pi

const NETWORK = `
#if IN_BLOCK
layout(std140) uniform Block { vec4 block[WEIGHTS]; };
vec4 weight(int i) { return block[i]; }
#else
uniform sampler2D weights;
vec4 weight(int i) { return texelFetch(weights, ivec2(i % 256, i / 256), 0); }
#endif
uniform sampler3D residual; uniform bool hasResidual; uniform float turn, darkest;
uniform vec2 alpha0, alpha1; uniform vec3 shares[${NODES}];
uniform sampler2D fitAlbedos, referenceAlbedos;  // of each lobe, by the viewer's angle
vec4 activated(vec4 x) { return FEATURED ? x / (1.0 + exp(-x)) : max(x, 0.0); }
LAYERS
vec3 expm1_of(vec3 x) { return vec3(expm1(x.r), expm1(x.g), expm1(x.b)); }
struct Half { float sine, cosine, cos_phi, sin_phi; vec3 difference; };
Half half_of(vec3 light, vec3 viewer) {
  vec3 total = light + viewer;
  float size = length(total);
  vec3 h = total / size, angle = azimuth(h);
  return Half(angle.x, h.z, angle.y, angle.z, difference(light, h, size));
}
vec3 fitted(Half at, float incident, float outgoing) {
  vec3 d = at.difference;
  float angle = atan(at.sine, at.cosine), square = angle * angle;
  vec4 x[INPUTS4];
#if KIND == 0
  x[0] = vec4(at.sine, 0.0, at.cosine, d.x); x[1] = vec4(d.y, d.z, 0.0, 0.0);
#elif KIND == 1
  float both = d.x * d.x + d.y * d.y, apart = square / (square + TURNS) * (d.x * d.x - d.y * d.y);
  float mean = at.cosine * d.z, differ = sqrt(at.sine * at.sine * d.x * d.x + GRAZING);
  x[0] = vec4(at.sine, 0.0, at.cosine, sqrt((both + apart) / 2.0 + SMOOTH));
  x[1] = vec4(sqrt((both - apart) / 2.0 + SMOOTH), d.z, mean - differ, mean + differ);
  x[2] = vec4(sqrt(angle), 1.0 / (1.0 + 100.0 * square), apart, 0.4 * log(square + 1e-4) + 1.0);
  x[3] = vec4(0.4 * log(vec3(square + 1e-2, max(mean - differ, 1e-3), max(mean + differ, 1e-3))) + 1.0, 0.0);
#else
  float along = angle * at.cos_phi, across = angle * at.sin_phi;
  vec3 squares = vec3(square, along * along, across * across);
  vec2 diagonals = vec2(along + across, along - across);
  diagonals = diagonals * diagonals / 2.0;
  float one = at.cos_phi * at.cosine * d.x - at.sin_phi * d.y, two = at.sin_phi * at.cosine * d.x + at.cos_phi * d.y;
  float both = max(incident * outgoing, 1e-6);
  x[0] = vec4(at.sine * at.cos_phi, at.sine * at.sin_phi, at.cosine, d.z);
  x[1] = vec4(d.x * d.x - d.y * d.y, d.x * d.y, d.z * d.z, both);
  x[2] = vec4((incident - outgoing) * (incident - outgoing), sqrt(angle), 1.0 / (1.0 + 100.0 * squares.xy));
  x[3] = vec4(1.0 / (1.0 + 100.0 * vec3(squares.z, diagonals)), one * one - two * two);
  x[4] = vec4(one * two, (squares.y - squares.z) / (squares.x + 1e-3), along * across / (squares.x + 1e-3), 0.4 * log(squares.x + 1e-4) + 1.0);
  x[5] = 0.4 * log(vec4(squares.x + 1e-2, squares.y + 1e-4, squares.y + 1e-2, squares.z + 1e-4)) + 1.0;
  x[6] = 0.4 * log(vec4(squares.z + 1e-2, diagonals + 1e-3, both)) + 1.0;
#endif
  vec3 last = last_layer(x);
  if (darkest == 0.0) return max(expm1_of(last), 0.0);
  return max((exp(min(last, 14.0)) - darkest) / max(incident * outgoing, darkest), 0.0);
}
// Return log(1 + f) of the samples less that of the fit. With phi_h the grid lies in slices of one phi_h + phi_d, side by
// side.
vec3 beyond(Half at) {
  float radius = sqrt(atan(at.sine, at.cosine) / (PI / 2.0)), theta_d = acos(clamp(at.difference.z, 0.0, 1.0)) / (PI / 2.0);
  float phi_d = atan(at.difference.y, at.difference.x) / PI;
#if SLICES == 0
  return textureLod(residual, vec3(radius, theta_d, phi_d * ${HALF_CIRCLE}.0 / float(textureSize(residual, 0).z)), 0.0).rgb;
#else
  float slices = float(SLICES), width = float(textureSize(residual, 0).x) / slices;
  float slice = fract(phi_d + atan(at.sin_phi, at.cos_phi) / PI) * slices - 0.5, first = floor(slice);
  vec2 disc = 0.5 + 0.5 * radius * vec2(at.sin_phi, at.cos_phi);
  float column = clamp((1.0 - sqrt(max(1.0 - theta_d, 0.0))) * width, 0.5, width - 0.5);  // so that the texture's filter does not read the next slice
  vec2 columns = (column + width * mod(vec2(first, first + 1.0), slices)) / (width * slices);
  return mix(textureLod(residual, vec3(columns.x, disc), 0.0).rgb, textureLod(residual, vec3(columns.y, disc), 0.0).rgb, slice - first);
#endif
}
void reflectances(vec3 wi, vec3 wo, out vec3 fit, out vec3 reference) {  // in 1/sr
  float axes = KIND == 2 ? -turn : 0.0;
  Half at = half_of(turned(wi, axes), turned(wo, axes));
  fit = fitted(at, wi.z, wo.z);
  vec3 base = fit;
#if KIND != 2 && SLICES > 0
  if (at.difference.y < 0.0) {  // the residual is known for phi_d in [0, pi] alone
    at.difference.xy = -at.difference.xy;
    base = fitted(at, wo.z, wi.z);
  }
#endif
  reference = hasResidual ? max(expm1_of(log(1.0 + base) + beyond(at)), 0.0) : fit;
}
void at_point(vec2 uv) {}
void response(vec3 wi, vec3 wo, out vec3 fit, out vec3 reference) {
  reflectances(wi, wo, fit, reference);
  fit *= wi.z; reference *= wi.z;
}
float node_of(vec3 wo) { return min(acos(clamp(wo.z, 0.0, 1.0)) * ${((NODES - 1) / LAST_NODE).toFixed(6)}, ${NODES - 1}.0); }
Lobes lobes(vec3 wo) {
  float place = node_of(wo);
  int node = min(int(place), ${NODES - 2});
  return Lobes(alpha0, alpha1, mix(shares[node], shares[node + 1], place - float(node)), turn);
}
vec3 albedo(sampler2D albedos, int lobe, float place) {
  int node = min(int(place), ${NODES - 2});
  return mix(texelFetch(albedos, ivec2(node, lobe), 0).rgb, texelFetch(albedos, ivec2(node + 1, lobe), 0).rgb, place - float(node));
}
void first_look(vec3 wo, mat3 frameOf, out vec3 fit, out vec3 reference) {
  float place = node_of(wo);
  vec3 other, light = matte_light(frameOf[2], other);
  fit = albedo(fitAlbedos, 0, place) * light; reference = albedo(referenceAlbedos, 0, place) * light;
  light = lobe_light(alpha0, turn, wo, frameOf, other);
  fit += albedo(fitAlbedos, 1, place) * light; reference += albedo(referenceAlbedos, 1, place) * light;
  light = lobe_light(alpha1, turn, wo, frameOf, other);
  fit += albedo(fitAlbedos, 2, place) * light; reference += albedo(referenceAlbedos, 2, place) * light;
}`;

// Return the code of the layers, with a variable for every four neurons: an array that is indexed would lie in memory.
// Weights are laid out by metapp.extensions.viewer.pages.brdf.pack_layers.
function layers(inputs4, hidden4) {
  const each = (count, text, between = " ") => Array.from({ length: count }, (_, i) => text(i)).join(between);
  const sum = (count, first, name) => each(count, (i) => `dot(weight(${first} + ${i}), ${name}${i})`, " + ");
  const group = 4 * inputs4 + 1, second = hidden4 * group, row = hidden4 + 1;
  const neurons = (g) => each(4, (k) => sum(inputs4, g * group + k * inputs4, "x"), ", ");
  return `vec3 last_layer(vec4 x[INPUTS4]) {
  ${each(inputs4, (i) => `vec4 x${i} = x[${i}];`)}
  ${each(hidden4, (g) => `vec4 h${g} = activated(weight(${g * group + 4 * inputs4}) + vec4(${neurons(g)}));`, "\n  ")}
  vec3 result = weight(${second + 4 * hidden4 * row}).rgb;
  for (int first = ${second}; first < ${second + 4 * hidden4 * row}; first += ${row}) {
    vec4 last = weight(first + ${hidden4});
    result += activated(vec4(last.w + ${sum(hidden4, "first", "h")})).x * last.rgb;
  }
  return result;
}`;
}

const EVALUATE = `
uniform sampler2D pairs;
void main() {
  int i = int(gl_FragCoord.x);
  vec3 fit, reference;
  reflectances(texelFetch(pairs, ivec2(i, 0), 0).xyz, texelFetch(pairs, ivec2(i, 1), 0).xyz, fit, reference);
  fitOut = vec4(fit, 1.0); referenceOut = vec4(reference, 1.0);
}`;

// Return the residual as a texture that repeats along phi_d, the last axis of the texture if there is no phi_h.
function tableOf(residual) {
  const [depth, height, ...widths] = residual ? residual.shape.slice(0, -1) : [1, 1, 1];
  const table = new THREE.Data3DTexture(residual ? residual.values : new Uint16Array(4), widths.reduce((a, b) => a * b), height, depth);
  const wrapR = widths.length === 1 ? THREE.RepeatWrapping : THREE.ClampToEdgeWrapping;
  return Object.assign(table, { format: THREE.RGBAFormat, type: THREE.HalfFloatType, ...LINEAR, wrapR, needsUpdate: true });
}

class BrdfViewer extends ShapeViewer {
  static shapes = ["sphere", "plane", "knot", "cylinder"];
  static lights = [["map", "Light map"], ["lamp", "Lamp"], ["studio", "Studio lights"]];  // the map comes first: under a lamp metals are black but for a dot

  async open() {
    const studio = await shared("studio");
    this.studio = texture(floatsOf(studio), studio.shape[1], 2);
    await super.open();
    this.plots = this.fits.map(() => make("canvas", { className: "plot", hidden: true }));
    this.element.append(...this.plots);
    this.samples = await Promise.all(this.fits.map((fit) => (fit.arrays.samples ? samplesOf(fit.arrays.samples) : [])));
  }

  _listed(values) {  // return the values as a texture of 256 texels a row
    const rows = Math.ceil(values.length / 1024), padded = new Float32Array(1024 * rows);
    padded.set(values);
    return texture(padded, 256, rows);
  }
  get largestBlock() { const gl = this.renderer.getContext(); return gl.getParameter(gl.MAX_UNIFORM_BLOCK_SIZE); }

  async material(fit) {
    const { network, inputs, hidden, smoothing, turn, darkest, alphas } = fit.facts, weights = await numbersOf(fit.arrays.weights);
    const shares = floatsOf(await numbersOf(fit.arrays.shares)), residual = fit.arrays.residual && await numbersOf(fit.arrays.residual);
    const defines = { KIND: ["nbrdf", "featured", "anisotropic"].indexOf(network), FEATURED: network !== "nbrdf", INPUTS4: Math.ceil(inputs / 4),
      WEIGHTS: weights.shape[0], SLICES: residual?.shape.length === 5 ? residual.shape[2] : 0,
      IN_BLOCK: weights.values.byteLength <= this.largestBlock ? 1 : 0 };
    ["TURNS", "SMOOTH", "GRAZING"].forEach((name, i) => { defines[name] = smoothing[i]; });
    const table = tableOf(residual);
    const glsl = Object.entries(defines).map(([name, value]) => `#define ${name} ${value}`).join("\n") + NETWORK.replace("LAYERS", layers(defines.INPUTS4, Math.ceil(hidden / 4)));
    return {
      glsl, block: defines.IN_BLOCK ? weights.values : null,
      uniforms: {
        ...(defines.IN_BLOCK ? {} : { weights: this._listed(weights.values) }), residual: table, hasResidual: Boolean(residual), turn: turn ?? 0,
        darkest, alpha0: new THREE.Vector2(...alphas[0]), alpha1: new THREE.Vector2(...alphas[1]),
        fitAlbedos: null, referenceAlbedos: null,
        shares: Array.from({ length: NODES }, (_, i) => new THREE.Vector3(...shares.slice(3 * i, 3 * i + 3))),
      },
    };
  }

  // Compute the albedo of each lobe by the viewer's angle, once for a material.
  prepare(material) {
    if (material.albedos) return;
    const u = material.uniforms, before = [u.light.value, u.frame.value, u.chunks.value];
    material.albedos = new THREE.WebGLRenderTarget(NODES, 3, { count: 2, type: THREE.FloatType, ...NEAREST, depthBuffer: false });
    [u.light.value, u.frame.value, u.chunks.value] = [ALBEDOS, DRAWN, 1];
    [u.fitAlbedos.value, u.referenceAlbedos.value] = [null, null];
    this._bind(material);
    this._fill(material, material.albedos);
    [u.light.value, u.frame.value, u.chunks.value] = before;
    [u.fitAlbedos.value, u.referenceAlbedos.value] = material.albedos.textures;
  }

  referenced(fit) { return "residual" in fit.arrays; }
  picture() { return { light: "studio", shape: "sphere", half: 1 / 0.96 }; }

  ownControls() {
    const told = this.fits.some((fit) => this.referenced(fit))
      ? "The reference is interpolated between its samples, as differences from the fit."
      : "There is no reference: the input is not at hand.";
    return [
      { name: "plot", label: "Plot at the pointer", type: "choice", value: "lobe",
        options: [["lobe", "Lobe of the viewer"], ["slice", "Slice at the lamp's theta_h"], ["none", "None"]] },
      { name: "told", label: told, type: "note" },
    ];
  }

  // Return the reflectance [fit, reference], RGB in 1/sr, of pairs of directions [[wi, wo], ...] in the surface's frame.
  evaluate(column, pairs) {
    const own = this.materials[column], count = pairs.length, values = new Float32Array(8 * count);
    pairs.forEach(([wi, wo], i) => { values.set(wi, 4 * i); values.set(wo, 4 * (count + i)); });
    if (!own.evaluator) {
      own.evaluator = new THREE.RawShaderMaterial({
        glslVersion: THREE.GLSL3, vertexShader: WHOLE, uniforms: { ...own.uniforms, pairs: { value: null } }, depthTest: false, depthWrite: false,
        fragmentShader: `${COMMON}\n${PIXEL}\n${own.glsl}\n${EVALUATE}`, blending: THREE.NoBlending,
      });
    }
    const directions = texture(values, count, 2), target = new THREE.WebGLRenderTarget(count, 1, { count: 2, type: THREE.FloatType, ...NEAREST });
    own.evaluator.uniforms.pairs.value = directions;
    this._bind(own);
    this._fill(own.evaluator, target);
    const results = [0, 1].map((which) => {
      const buffer = new Float32Array(4 * count);
      this.renderer.readRenderTargetPixels(target, 0, 0, count, 1, buffer, undefined, which);
      return Array.from({ length: count }, (_, i) => Array.from(buffer.subarray(4 * i, 4 * i + 3)));
    });
    directions.dispose();
    target.dispose();
    return results;
  }

  changed(name) {
    super.changed(name);
    if (name === "plot") this.plots.forEach((plot) => { plot.hidden = true; });
  }

  pointed(place) {
    if (this.settings.plot === "none") return;
    const met = this.pick(place), { fit: column } = place;
    this.plots.forEach((plot, i) => { plot.hidden = !met || i !== column; });
    if (!met) return;
    const lamp = this.lampAt.clone().multiplyScalar(LAMP_DISTANCE).sub(met.p).normalize(), half = lamp.clone().add(met.towards).normalize();
    const [viewer, thetaH, thetaD] = [met.towards.dot(met.n), half.dot(met.n), half.dot(lamp)].map((x) => Math.acos(clamp(x, 0.001, 1)));
    const [seen, slanted] = [met.towards, half].map((direction) => azimuthOf(direction, met));
    if (this.settings.plot === "lobe") this.plot(column, lobeOf(viewer, seen), { at: viewer, seen: "viewer", title: `In the plane of incidence, viewer at ${degrees(viewer)}`, axis: "angle of the light from the normal" });
    else this.plot(column, sliceOf(thetaH, slanted), { at: thetaD, seen: "lamp", title: `At theta_h ${degrees(thetaH)}, lamp at theta_d ${degrees(thetaD)}`, axis: "theta_d; right: phi_d 90\u00b0, left: 0\u00b0" });
  }

  plot(fit, { pairs, angles, near }, told) {
    const [curve, reference] = this.evaluate(fit, pairs).map((values) => values.map(meanOf));
    const dots = this.samples[fit].flatMap(({ angles: sampled, rgb }) => near(...sampled).map((angle) => [angle, meanOf(rgb)]));
    drawPolar(this.plots[fit], { angles, fit: curve, reference: this.referenced(this.fits[fit]) ? reference : null, dots, ...told });
  }
}

const meanOf = (rgb) => (rgb[0] + rgb[1] + rgb[2]) / 3;
const degrees = (angle) => `${Math.round(angle * 180 / Math.PI)}\u00b0`;

// Return the angles theta_h, theta_d, phi_d, phi_h if any, and the RGB of each sample.
async function samplesOf(spec) {
  const values = floatsOf(await numbersOf(spec)), width = spec.shape[1];
  return Array.from({ length: spec.shape[0] }, (_, i) => {
    const row = values.subarray(width * i, width * (i + 1));
    return { angles: row.subarray(0, width - 3), rgb: row.subarray(width - 3) };
  });
}

// Return a direction in the local frame of a place that `pick` has found.
function azimuthOf(direction, { n, t }) {
  const x = t.clone().addScaledVector(n, -n.dot(t)).normalize();
  return Math.atan2(direction.dot(n.clone().cross(x)), direction.dot(x));
}

const turnedBy = (azimuth, [x, y, z]) => [x * Math.cos(azimuth) - y * Math.sin(azimuth), x * Math.sin(azimuth) + y * Math.cos(azimuth), z];

VIEWERS.brdf = BrdfViewer;
