// GLSL of shapes and light maps: the surface that is seen at each pixel, its light, the sum of frames, and the shown parts.

const LAMP_DISTANCE = 2.414;  // distance of a lamp that gives radiance 1 to a white matte surface facing it
const NODES = 24;             // number of the viewer's angles at which lobes are tabulated
const LAST_NODE = 89 * Math.PI / 180;
const PLACES = 8;             // number of places around a lobe at which a blurred light map is read

const COMMON = `
precision highp float; precision highp int; precision highp sampler2D; precision highp sampler3D;
const float PI = 3.14159265358979;
#define float3 vec3
${FACETS}
vec3 towards_node(int i) { float angle = float(i) * ${(LAST_NODE / (NODES - 1)).toFixed(7)}; return vec3(sin(angle), 0.0, cos(angle)); }
struct Lobes { vec2 first; vec2 second; vec3 shares; float turn; };  // GGX alphas of two lobes; shares of the cosine and of both

uint seed; float draw, stride;  // seed of the pixel; number of the frame; step of random numbers from frame to frame
// PCG of the pixel, and from frame to frame a Kronecker sequence, whose mean converges faster: powers of the root of g^6 + g^5 = 1.
float random() {
  seed = seed * 747796405u + 2891336453u;
  uint word = ((seed >> ((seed >> 28u) + 4u)) ^ seed) * 277803737u;
  stride *= 0.88127;
  return fract(float((word >> 22u) ^ word) * (1.0 / 4294967296.0) + draw * stride);
}
vec3 turned(vec3 v, float angle) { float c = cos(angle), s = sin(angle); return vec3(c * v.x - s * v.y, s * v.x + c * v.y, v.z); }
vec3 lobes_densities(Lobes m, vec3 v, vec3 l) {  // densities of the cosine and of both lobes
  if (l.z <= 0.0) return vec3(0.0);
  vec3 v_axes = turned(v, -m.turn), l_axes = turned(l, -m.turn);
  return m.shares * vec3(l.z / PI, facets(l_axes, v_axes, vec3(m.first, 1.0)), facets(l_axes, v_axes, vec3(m.second, 1.0)));
}
float lobes_density(Lobes m, vec3 v, vec3 l) { return dot(lobes_densities(m, v, l), vec3(1.0)); }
vec3 lobes_sample(Lobes m, vec3 v) {
  float choice = random();
  vec2 u = vec2(random(), random());
  if (choice < m.shares.x) {
    float radius = sqrt(u.x), phi = 2.0 * PI * u.y;
    return vec3(radius * cos(phi), radius * sin(phi), sqrt(1.0 - u.x));
  }
  vec3 viewer = turned(v, -m.turn);
  vec2 alpha = choice < m.shares.x + m.shares.y ? m.first : m.second;
  return turned(reflect(-viewer, facet(viewer, vec3(alpha, 1.0), u.x, u.y)), m.turn);
}`;

const VERTEX = `
precision highp float; precision highp sampler2D;
// The surface that is seen at each pixel, which is shaded later: shading triangles at once would cost time for hidden ones, and
// for the quads at their edges.
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

// A pixel of the surface that is seen, and light maps, laid out as in metapp.appearance.latlong: u = atan2(x, -z) / 2 pi,
// v = acos(y) / pi.
const PIXEL = `
uniform sampler2D seen0, seen1, seen2;
vec3 P, N, T; vec2 U;
layout(location = 0) out vec4 fitOut; layout(location = 1) out vec4 referenceOut;
uniform vec3 eye; uniform vec3 towardsEye; uniform bool parallel;
uniform sampler2D map, referenceMap, matte, referenceMatte; uniform vec2 mapSize; uniform float mapScale, mapTurn;

bool seen_at(ivec2 pixel, out mat3 frameOf, out vec3 wo) {
  vec4 place = texelFetch(seen0, pixel, 0), first_two = texelFetch(seen1, pixel, 0), last_two = texelFetch(seen2, pixel, 0);
  fitOut = referenceOut = vec4(0.0);
  if (place.w == 0.0) return false;
  P = place.xyz; N = first_two.xyz; T = last_two.xyz; U = vec2(first_two.w, last_two.w);
  vec3 towards = parallel ? towardsEye : normalize(eye - P);
  vec3 n = normalize(N);
  if (dot(n, towards) < 0.0) n = -n;
  vec3 t = normalize(T - n * dot(n, T));
  frameOf = mat3(t, cross(n, t), n);
  wo = towards * frameOf;
  wo = normalize(vec3(wo.xy, max(wo.z, 1e-3)));
  return true;
}
vec2 place_of(vec3 d) { return vec2(fract(atan(d.x, -d.z) / (2.0 * PI) - mapTurn), acos(clamp(d.y, -1.0, 1.0)) / PI); }
// Return the mean light of both maps over the cosine about a direction, and over a lobe, in the frame of the shape. Levels of
// the maps are as coarse as the distances of the places at which light is read.
vec3 matte_light(vec3 n, out vec3 other) {
  vec2 at = place_of(n);
  other = mapScale * textureLod(referenceMatte, at, 0.0).rgb;
  return mapScale * textureLod(matte, at, 0.0).rgb;
}
vec3 lobe_light(vec2 alpha, float turn, vec3 wo, mat3 frameOf, out vec3 other) {
  vec3 v = turned(wo, -turn), sum = vec3(0.0);
  float total = 0.0;
  other = vec3(0.0);
  for (int i = 0; i < ${PLACES}; i++) {
    vec3 l = reflect(-v, facet(v, vec3(alpha, 1.0), (float(i) + 0.5) / ${PLACES}.0, 0.618034 * float(i)));
    if (l.z <= 0.0) continue;
    float radius = sqrt(1.0 / (${PLACES}.0 * PI * facets(l, v, vec3(alpha, 1.0))));
    float level = max(log2(1.5 * radius * mapSize.y / PI), 0.0);
    vec2 at = place_of(frameOf * turned(l, turn));
    sum += textureLod(map, at, level).rgb;
    other += textureLod(referenceMap, at, level).rgb;
    total += 1.0;
  }
  other *= mapScale / max(total, 1.0);
  return sum * mapScale / max(total, 1.0);
}`;

const UNLIT = `
#ifndef UNLIT
void unlit(inout vec3 fit, inout vec3 reference) {}
#endif
void put(vec3 fit, vec3 reference) {
  unlit(fit, reference);
  if (any(isnan(fit)) || any(isinf(fit))) fit = vec3(0.0);
  if (any(isnan(reference)) || any(isinf(reference))) reference = vec3(0.0);
  fitOut = vec4(fit, 1.0); referenceOut = vec4(reference, 1.0);
}`;

const FIRST_LOOK = `${UNLIT}
void main() {
  mat3 frameOf;
  vec3 wo, fit, reference;
  if (!seen_at(ivec2(gl_FragCoord.xy), frameOf, wo)) return;
  at_point(U);
  first_look(wo, frameOf, fit, reference);
  put(fit, reference);
}`;

const ALBEDOS = 3;  // number of the light that stands for albedos: of each lobe, by the viewer's angle in x and the lobe in y
const FRAGMENT = `${UNLIT}
uniform int light, frame, chunks; uniform vec3 lamp; uniform float flashPower;
uniform sampler2D places, studio; uniform float mapTotal;

#ifndef BENT
mat3 bent() { return mat3(1.0); }
#endif
float map_density(vec2 at) { return textureLod(map, at, 0.0).a / (mapTotal * max(sin(PI * at.y), 1e-4)); }  // density of samples: luminance
float tent(float u) { float t = 2.0 * u - 1.0; return sign(t) * (1.0 - sqrt(1.0 - abs(t))); }
vec3 map_sample() {  // spread around a texel as radiance is interpolated, so that a bright texel among dark ones makes no noise
  int count = textureSize(places, 0).x;
  vec2 texel = texelFetch(places, ivec2(min(int(random() * float(count)), count - 1), 0), 0).xy;
  float phi = 2.0 * PI * ((texel.x + 0.5 + tent(random())) / mapSize.x + mapTurn), theta = PI * (texel.y + 0.5 + tent(random())) / mapSize.y;
  float radius = abs(sin(theta));  // places beyond a pole are mirrored at it
  return vec3(radius * sin(phi), cos(theta), -radius * cos(phi));
}
// Light from one direction in the frame of the shape, and the weight of the response to it.
vec3 by_lamp(mat3 frameOf, out vec3 weight) {
  vec3 towards = lamp - P;
  weight = vec3(flashPower / dot(towards, towards));
  return normalize(towards) * frameOf;
}
vec3 by_map(vec3 wo, mat3 frameOf, out vec3 weight, out vec3 other) {  // one sample by each strategy, weighted by the balance heuristic
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
// The lights of metapp's pictures of BRDFs, of which each frame takes some: row 0 holds directions, row 1 irradiance. For
// rings about each normal row 0 holds half vectors in the frame of the shape, row 1 a solid angle, and 1 as its fourth number.
vec3 by_studio(int i, vec3 wo, mat3 frameOf, out vec3 weight) {
  vec4 where = texelFetch(studio, ivec2(i, 0), 0), power = texelFetch(studio, ivec2(i, 1), 0);
  weight = power.rgb * float(chunks);
  if (power.a < 0.5) return where.xyz * frameOf;
  float cosine = max(dot(wo, where.xyz), 0.0);
  vec3 wi = 2.0 * cosine * where.xyz - wo;
  weight *= 4.0 * cosine * (0.06 + 0.05 * (frameOf * wi).y);
  return wi;
}
// Return the share that a lobe has of all that is reflected of uniform light.
vec3 by_lobe(int which, vec3 wo, out vec3 weight) {
  Lobes mixture = lobes(wo);
  vec3 wi = lobes_sample(mixture, wo), densities = lobes_densities(mixture, wo, wi);
  float density = dot(densities, vec3(1.0));
  weight = vec3(densities[which] / max(density * density * float(frame), 1e-20));
  return wi;
}
void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  mat3 frameOf = mat3(1.0);
  vec3 wo, fit = vec3(0.0), reference = vec3(0.0), a, b, weight, other;
  int first = 0, last = 1;
  uvec2 noise = light == ${ALBEDOS} ? uvec2(pixel.x, 0) : uvec2(gl_FragCoord.xy);
  seed = noise.x * 1973u + noise.y * 9277u + 1u;
  random(); random();
  draw = float(frame); stride = 1.0;
  if (light == ${ALBEDOS}) { wo = towards_node(pixel.x); last = frame; }
  else if (!seen_at(pixel, frameOf, wo)) return;
  at_point(U);
  if (light == 2) { first = frame % chunks; last = textureSize(studio, 0).x; }  // each frame takes lights of each kind
  for (int i = first; i < last; i += chunks) {  // a single call of response in the code, which may be long
    vec3 wi;
    if (light == ${ALBEDOS}) {  // averaged over azimuths of the viewer
      draw = float(i); stride = 1.0;
      wo = turned(wo, 2.399963);
      wi = by_lobe(pixel.y, wo, weight);
    } else wi = light == 0 ? by_lamp(frameOf, weight) : light == 1 ? by_map(wo, frameOf, weight, other) : by_studio(i, wo, frameOf, weight);
    if (light != 1) other = weight;
    if (wi.z <= 1e-4) continue;
    response(wi, wo, a, b);
    fit += a * weight; reference += b * other;
  }
  put(fit, reference);
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
// Put fit and reference on the screen, in a pane: column is [left, bottom, width, height] in px, show is one of PARTS.
const SHOWING = `
precision highp float; precision highp int; precision highp sampler2D;
uniform float exposure, full, wipe, mapScale; uniform int curve, show; uniform vec4 column; uniform vec3 paper;
uniform sampler2D map, referenceMap;
out vec4 result;
vec3 srgb(vec3 x) { return mix(12.92 * x, 1.055 * pow(max(x, 0.0031308), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, x)); }
vec3 encoded(vec3 x) {  // the tone curves of metapp's PNGs
  x = max(x * exposure, 0.0);
  if (curve == 1) return pow(clamp(x, 1e-6, 1.0), vec3(1.0 / 2.2));
  return srgb(curve == 2 ? x / (1.0 + x) : min(x, 1.0));
}
${HEAT_GLSL}
float difference(vec3 a, vec3 b) { return dot(abs(a - b), vec3(1.0 / 3.0)); }  // difference of display values, the mean over channels
bool is_reference() { return show == 1 || (show == 2 && gl_FragCoord.x - column.x < wipe * column.z); }`;
const DISPLAY = `${SHOWING}
uniform sampler2D fit, reference, fitUnder, referenceUnder, fitLook, referenceLook;
uniform float samples, scale, first, underScale, underFirst, trust, surround, mapTurn;
uniform bool looked, mapBehind, parallel; uniform mat4 fromClip; uniform vec3 eye;
vec4 read(sampler2D sum, float scale, float first) {  // interpolated between pixels of a coarser picture, if all of them are drawn
  ivec2 offset = ivec2(first, 0);
  vec2 at = (gl_FragCoord.xy - column.xy) * scale;
  vec4 nearest = texelFetch(sum, offset + ivec2(at), 0);
  if (scale >= 1.0 || nearest.a < 0.0) return nearest;
  ivec2 low = max(ivec2(floor(at - 0.5)), 0), high = min(low + 1, ivec2(ceil(column.zw * scale)) - 1);
  vec2 share = clamp(at - 0.5 - vec2(low), 0.0, 1.0);
  vec4 a = texelFetch(sum, offset + low, 0), b = texelFetch(sum, offset + ivec2(high.x, low.y), 0);
  vec4 c = texelFetch(sum, offset + ivec2(low.x, high.y), 0), d = texelFetch(sum, offset + high, 0);
  if (min(min(a.a, b.a), min(c.a, d.a)) < 0.0) return nearest;
  return mix(mix(a, b, share.x), mix(c, d, share.x), share.y);
}
// Return the mean of samples: of the coarse picture where no sample is drawn yet, and mixed with the first look while samples
// are few.
vec4 shown(sampler2D sum, sampler2D under, sampler2D look) {
  vec4 v = read(sum, scale, first), at_first = looked ? read(look, scale, first) : vec4(0.0);
  at_first.rgb /= max(at_first.a, 1e-6);
  float share = v.a < 0.0 ? 0.0 : trust, count = samples;
  bool lacks = v.a < 0.0 && underScale == 0.0;
  if (v.a < 0.0) { v = underScale > 0.0 ? read(under, underScale, underFirst) : vec4(0.0); count = 1.0; }
  vec4 mean = v.a > 0.0 ? vec4(v.rgb / v.a, v.a / count) : vec4(0.0);
  if (surround > 0.0) mean = vec4(mean.rgb + surround * at_first.rgb, lacks ? at_first.a : mean.a);
  else if (looked) mean = vec4(mean.a == 0.0 ? at_first.rgb : at_first.a == 0.0 ? mean.rgb : mix(at_first.rgb, mean.rgb, share), mix(at_first.a, mean.a, share));
  return mean.a > 0.0 ? vec4(encoded(mean.rgb), mean.a) : vec4(0.0);
}
vec3 behind() {
  if (!mapBehind || parallel) return paper;
  vec4 far = fromClip * vec4((gl_FragCoord.xy - column.xy) / column.zw * 2.0 - 1.0, 1.0, 1.0);
  vec3 d = normalize(far.xyz / far.w - eye);
  vec2 at = vec2(fract(atan(d.x, -d.z) / 6.28318530718 - mapTurn), acos(clamp(d.y, -1.0, 1.0)) / 3.14159265359);
  return encoded((is_reference() ? textureLod(referenceMap, at, 0.0) : textureLod(map, at, 0.0)).rgb * mapScale);
}
void main() {
  vec4 a = shown(fit, fitUnder, fitLook), b = shown(reference, referenceUnder, referenceLook);
  float apart = difference(a.rgb, b.rgb);
  if (show == 4) { result = vec4(vec3(apart), a.a); return; }
  if (show == 3) { result = vec4(mix(paper, heat(apart / full), a.a), 1.0); return; }
  vec4 chosen = is_reference() ? b : a;
  result = vec4(mix(behind(), chosen.rgb, chosen.a), 1.0);
}`;
