// The viewer of flat materials: maps on shapes, and as in metapp's pictures (metapp.appearance.surface_view,
// metapp.appearance.flash).
//
// pictures: fit_diffuse and fit_specular at gamma 2.2, fit_detail (x and y of normals, 0 at 128, and roughness), height from the
// lowest to the highest of facts.heights, in texture widths; reference_diffuse and so on if the true maps are known; photo_1, ...
// at gamma 2.2; for photographs under a lamp that is dragged, what scripts/relit.js reads.
// facts: lit has light, eye, gain and shown part of metapp's pictures, by name; see make_surface_view in
// metapp.extensions.viewer.pages.flat for the others.

const MAPS = ["diffuse", "specular", "detail"];
const SHOWN_MAPS = { lit: "Material", diffuse: "Diffuse", specular: "Specular", roughness: "Roughness", normal: "Normal", height: "Height" };
// For each shape: copies of the maps around it for one copy along it, the width of a copy, and vertices across.
const UNROLLED = { plane: [1, 2, 256], cylinder: [2, 2.2, 256], sphere: [2, Math.PI, 192], cloth: [1, 2.4, 256] };

const MARCH = 16;  // number of places between a point and its light at which heights are compared

// Heights from 0 to 1, for vertices and pixels: places count copies from the upper left, which are mirrored unless maps tile.
const HEIGHTS = `
uniform sampler2D height; uniform vec2 repeats, heights; uniform bool tiles;
vec2 odd(vec2 place) { return tiles ? vec2(0.0) : mod(floor(place), 2.0); }
vec2 folded(vec2 place) { return mix(fract(place), 1.0 - fract(place), odd(place)); }
float height_at(vec2 place, float level) { return textureLod(height, folded(place), level).r; }`;

const MATERIAL = `
#define BENT
#define UNLIT
${HEIGHTS}
struct Texel { vec3 diffuse; vec3 specular; vec3 n; float roughness; };
uniform sampler2D fit_diffuse, fit_specular, fit_detail, reference_diffuse, reference_specular, reference_detail, photo;
uniform bool pictured, hasReference, hasPhoto; uniform float across, falloff, steepness; uniform int shownMap;
Texel fitAt, referenceAt; vec2 at, turned_over, within;

// Metapp's pictures have a pixel for each texel, so in them texels are squares, unless they are enlarged; elsewhere frames are
// jittered, which smooths as half a level of the texture would. The patch is so many pixels across.
vec4 read(sampler2D map, vec2 place, float copies) {
  vec2 size = vec2(textureSize(map, 0));
  float texels = copies * size.y / across;
  if (pictured && texels > 0.99) return textureLod(map, (floor(min(place, 1.0 - 1e-6) * size) + 0.5) / size, 0.0);
  return textureLod(map, place, max(log2(texels) - 0.5, 0.0));
}
vec3 decoded(vec3 shown) { return pow(shown, vec3(2.2)); }
Texel texel(sampler2D diffuse, sampler2D specular, sampler2D detail) {
  vec3 x_y_roughness = read(detail, at, repeats.y).rgb;
  vec2 slant = (x_y_roughness.xy * 255.0 - 128.0) / 127.0 * turned_over;
  vec3 n = normalize(vec3(slant, sqrt(max(1.0 - dot(slant, slant), 1e-4))));
  return Texel(decoded(read(diffuse, at, repeats.y).rgb), decoded(read(specular, at, repeats.y).rgb), n, max(x_y_roughness.z, 0.04));
}
void at_point(vec2 uv) {
  within = vec2(uv.x, 1.0 - uv.y);  // row 0 is the upper edge
  turned_over = 1.0 - 2.0 * odd(within * repeats);
  at = folded(within * repeats);
  fitAt = texel(fit_diffuse, fit_specular, fit_detail);
  if (hasReference) referenceAt = texel(reference_diffuse, reference_specular, reference_detail);
  else referenceAt = fitAt;
}
vec3 reflected(Texel m, vec3 wi, vec3 wo) {  // metapp.appearance.flash.evaluate_brdf times the cosine
  float incident = dot(wi, m.n), outgoing = dot(wo, m.n), length_ = length(wi + wo), alpha = m.roughness * m.roughness;
  if (incident <= 0.0) return vec3(0.0);
  vec3 body = m.diffuse * (1.0 - m.specular) / PI;
  if (outgoing <= 0.0) return body * incident;
  float half_ = min((incident + outgoing) / length_, 1.0), spread = (1.0 - half_) * (1.0 + half_) + alpha * alpha * half_ * half_;
  float masked = (incident + sqrt((1.0 - incident * incident) * alpha * alpha + incident * incident))
    * (outgoing + sqrt((1.0 - outgoing * outgoing) * alpha * alpha + outgoing * outgoing));
  vec3 fresnel = m.specular + (1.0 - m.specular) * pow(max(1.0 - 0.5 * length_, 0.0), 5.0);
  return (body + fresnel * alpha * alpha / (PI * spread * spread * masked)) * incident;
}
// Return whether heights hide the light: march until the ray is above all of them, at most a copy away. Lengths are in copies.
bool shadowed(vec3 wi) {
  vec2 place = within * repeats, along = vec2(wi.x, -wi.y) / wi.z;
  float rise = steepness * (heights.y - heights.x), here = rise * height_at(place, 0.0), part = 1.0 / ${MARCH}.0;
  float most = min(rise - here, 1.0 / max(length(along), 1e-6)), texels = part * most * length(along) * float(textureSize(height, 0).y);
  for (float share = random() * part; share < 1.0; share += part) {
    float above = share * most, there = rise * height_at(place + above * along, max(log2(texels) - 1.0, 0.0));
    if (there > here + above + 0.02 * rise) return true;
  }
  return false;
}
void response(vec3 wi, vec3 wo, out vec3 fit, out vec3 reference) {
  fit = reference = vec3(0.0);
  if (steepness > 0.0 && shadowed(wi)) return;
  float flat_lamp = falloff > 0.0 ? pow(wi.z, falloff) : 1.0;  // the axis of the flash points straight down
  fit = flat_lamp * reflected(fitAt, wi, wo);
  reference = hasReference ? flat_lamp * reflected(referenceAt, wi, wo) : fit;
}
mat3 bent() {
  vec3 t = normalize(vec3(1.0, 0.0, 0.0) - fitAt.n * fitAt.n.x);
  return mat3(t, cross(fitAt.n, t), fitAt.n);
}
Lobes lobes(vec3 wo) {
  const vec3 LUMINANCE = vec3(0.2126, 0.7152, 0.0722);
  float f0 = dot(fitAt.specular, LUMINANCE), mirrored = f0 + (1.0 - f0) * pow(1.0 - wo.z, 5.0), body = dot(fitAt.diffuse, LUMINANCE) * (1.0 - f0);
  float share = clamp(mirrored / (mirrored + body + 1e-4), 0.2, 0.9);
  return Lobes(vec2(fitAt.roughness * fitAt.roughness), vec2(1.0), vec3(1.0 - share, share, 0.0), 0.0);
}
// Approximate the radiance under a light map: blurred light times the share that GGX reflects (Karis 2014).
vec3 about(Texel m, vec3 wo, mat3 frameOf) {
  vec3 t = normalize(vec3(1.0, 0.0, 0.0) - m.n * m.n.x), other, viewer;
  mat3 axes = mat3(t, cross(m.n, t), m.n);
  viewer = wo * axes;
  viewer = normalize(vec3(viewer.xy, max(viewer.z, 1e-3)));
  vec4 r = m.roughness * vec4(-1.0, -0.0275, -0.572, 0.022) + vec4(1.0, 0.0425, 1.04, -0.04);
  vec2 gloss = min(r.x * r.x, exp2(-9.28 * viewer.z)) * r.x * vec2(-1.04, 1.04) + r.y * vec2(-1.04, 1.04) + r.zw;
  return m.diffuse * (1.0 - m.specular) * matte_light(frameOf * m.n, other)
    + (m.specular * gloss.x + gloss.y) * lobe_light(vec2(m.roughness * m.roughness), 0.0, viewer, frameOf * axes, other);
}
void first_look(vec3 wo, mat3 frameOf, out vec3 fit, out vec3 reference) {
  fit = about(fitAt, wo, frameOf);
  reference = hasReference ? about(referenceAt, wo, frameOf) : fit;
}
vec3 value(Texel m) {
  if (shownMap == 1) return m.diffuse;
  if (shownMap == 2) return m.specular;
  return decoded(shownMap == 3 ? vec3(m.roughness) : shownMap == 4 ? 0.5 * m.n + 0.5 : read(height, at, repeats.y).rrr);
}
void unlit(inout vec3 fit, inout vec3 reference) {
  if (shownMap > 0) { fit = value(fitAt); reference = value(referenceAt); }
  else if (hasPhoto) reference = decoded(read(photo, within, 1.0).rgb);
}`;

const RELIEF = `${HEIGHTS}
uniform bool poles; uniform float relief, heightLod;
float displacement(vec2 uv) {
  float share = height_at(vec2(uv.x, 1.0 - uv.y) * repeats, heightLod);
  float faded = poles ? smoothstep(0.0, 0.04, min(uv.y, 1.0 - uv.y)) : 1.0;  // heights fade towards poles, where the shape is a point
  return relief * mix(heights.x, heights.y, share) * faded;
}`;

class SurfaceViewer extends ShapeViewer {
  static shapes = ["plane", "cylinder", "sphere", "cloth"];
  static curve = 1;

  async open() {
    this.nothing = texture(new Float32Array(4), 1, 1);
    this.photos = new Map(); this.relit = new Map();
    await super.open();
  }

  close() {
    this.relit?.forEach((each) => each.free());
    super.close();
  }

  async material(fit) {
    const { tiles, heights } = fit.facts, known = "reference_diffuse" in fit.pictures;
    const uniforms = { height: await pictureTexture(fit.pictures.height, tiles), hasReference: known, tiles, heights: new THREE.Vector2(...heights) };
    for (const name of MAPS) {
      uniforms[`fit_${name}`] = await pictureTexture(fit.pictures[`fit_${name}`], tiles);
      uniforms[`reference_${name}`] = known ? await pictureTexture(fit.pictures[`reference_${name}`], tiles) : this.nothing;
    }
    for (const [name, address] of Object.entries(fit.pictures)) {
      if (/^(photo|plane)_/.test(name) && !this.photos.has(address)) this.photos.set(address, await pictureTexture(address, false));
    }
    if (fit.facts.relit) {
      const planes = fit.facts.relit.ranges.map((_, k) => this.photos.get(fit.pictures[`plane_${k}`]));
      this.relit.set(fit, await RelitPhotos.of(this, fit, planes, uniforms.fit_detail));
    }
    const changing = { photo: this.nothing, repeats: new THREE.Vector2(1, 1), pictured: false, hasPhoto: false, across: 1, falloff: 0, shownMap: 0, relief: 0, steepness: 0, heightLod: 0, poles: false };
    return { glsl: MATERIAL, displacement: RELIEF, uniforms: { ...uniforms, ...changing } };
  }

  // Return the chosen picture of metapp for one fit; other fits of the group may have another number of photographs.
  lit(fit) {
    const { lit } = fit.facts, name = this.settings.pictured in lit ? this.settings.pictured : Object.keys(lit)[0];
    const light = name === "relit" ? this.lampAt.clone().multiplyScalar(lit.relit.light[2]).toArray() : lit[name].light;
    return { name, ...lit[name], light };
  }
  get hasFlatLamp() { return this.isFlat && this.settings.map === "lit" && this.lit(this.fits[0]).name === "relit"; }
  putLamp(direction) {  // photographs have no lamps below the horizon
    super.putLamp(this.hasFlatLamp ? direction.setZ(Math.max(direction.z, 0)) : direction);
  }
  changed(name) {
    if (this.hasFlatLamp) this.putLamp(this.lampAt);
    super.changed(name);
  }

  picture() {
    const { light, eye, gain } = this.lit(this.fits[0]);
    return { shape: "plane", light: "lamp", half: 1, lamp: new THREE.Vector3(...light), eye: new THREE.Vector3(...eye), power: gain * Math.PI * LAMP_DISTANCE ** 2 };
  }

  photo(fit) {
    if (this.settings.view !== "picture") return null;
    const { name } = this.lit(fit);
    return name === "relit" ? this.relit.get(fit).under(this.lampAt, this.settings) : this.photos.get(fit.pictures[name]);
  }
  firstView() { return this.fits.some(({ pictures, facts }) => "photo_1" in pictures || facts.relit) ? "picture" : "free"; }  // first the photo beside the fit under its flash
  shapeOfPane() {  // photographs that are relit are shown whole, whatever their shape
    const { relit, shown } = this.fits[0].facts;
    return relit && this.isFlat ? shown[1] / shown[0] : 1;
  }
  lampShown() { return this.hasFlatLamp || (super.lampShown() && this.settings.map === "lit"); }
  hasPhoto(fit) { return this.settings.view === "picture" && (this.lit(fit).name === "relit" || this.lit(fit).name in fit.pictures); }
  named(fit) { return !this.hasPhoto(fit) ? super.named(fit) : this.hasFlatLamp ? "Photos, relit" : "Photo"; }
  referenced(fit) {
    const { map = "lit" } = this.settings;
    return map === "height" ? false : "reference_diffuse" in fit.pictures || (map === "lit" && this.hasPhoto(fit));
  }

  most() { return this.settings.map === "lit" ? super.most() : 16; }

  beforeDraw(u, column, { width: pixels, height: rows }) {
    const fit = this.fits[column], { settings } = this, pictured = settings.view === "picture", lit = this.lit(fit);
    const [around, width, vertices] = UNROLLED[this.shape()], count = pictured ? lit.part : settings.repeats;
    const photo = this.photo(fit), high = this.camera.position.length() * Math.tan(this.camera.fov * Math.PI / 360);
    u.repeats.value.set(pictured ? count : around * count, count);
    u.pictured.value = pictured;
    u.across.value = pictured ? rows / this.flatMargins(pixels / rows)[1] * this.framing.zoom : rows / high;
    u.heightLod.value = Math.max(Math.log2(around * count * fit.facts.shown[1] / vertices), 0);
    u.relief.value = pictured ? 0 : settings.relief * width / count;
    u.steepness.value = pictured || settings.map !== "lit" ? 0 : settings.relief;
    u.poles.value = this.shape() === "sphere";
    u.shownMap.value = Object.keys(SHOWN_MAPS).indexOf(settings.map);
    u.hasPhoto.value = Boolean(photo);
    u.photo.value = photo || this.nothing;
    u.falloff.value = pictured ? fit.facts.falloff : 0;
    if (!pictured) return;
    u.jitter.value.multiplyScalar(0.9);  // stays within the texel, since rasterisers round places to about a sixteenth of a pixel
    u.lamp.value = new THREE.Vector3(...lit.light);
    u.eye.value = new THREE.Vector3(...lit.eye);
    u.flashPower.value = lit.gain * Math.PI * LAMP_DISTANCE ** 2;
  }

  ownControls() {
    const [fit] = this.fits, { lit, tiles, size, shown, fitted_height: fitted, relit } = fit.facts, photos = Object.keys(fit.pictures).filter((name) => name.startsWith("photo_"));
    const titles = { relit: "Under a lamp to drag", left: "Lit from the left", above: "Lit from above", aside: "Lit and seen from aside", photo_1: !photos.length ? "Under the flash" : photos.length > 1 ? "As photo 1" : "As the photo" };
    const free = (s) => s.view === "free", compared = "reference_diffuse" in fit.pictures;
    const notes = [
      tiles ? "The maps tile." : "The maps do not tile: copies are mirrored.",
      fitted ? "" : `Heights are computed from the normals${tiles ? "" : ", without their curvature over the whole map"}.`,
      photos.length ? `The photo${photos.length > 1 ? "s stand" : " stands"} beside the fit under ${photos.length > 1 ? "their flashes" : "its flash"}. View, Free: other shapes, and a lamp to drag.${compared ? " There the reference is the true maps." : ""}` : "",
      relit ? `Beside the fitted maps stands what ${relit.photos} photos say of the object under the lamp. Drag the lamp, or anywhere in the pictures; wheel or two fingers zoom, the right button moves them. View, Free: other shapes.` : "",
      lit.photo_1?.part < 1 ? "The maps are larger than the photo: under its flash their upper left part is shown." : "",
      shown[0] < size[0] ? `Reduced from ${size[1]} x ${size[0]} to ${shown[1]} x ${shown[0]} texels for this page.` : "",
    ];
    return [
      { name: "pictured", label: "Picture", type: "choice", value: Object.keys(lit)[0], when: (s) => s.view === "picture",
        options: Object.keys(lit).map((name) => [name, titles[name] ?? `As ${name.replace("_", " ")}`]) },
      { name: "map", label: "Map", type: "choice", value: "lit", options: Object.entries(SHOWN_MAPS) },
      ...relitControls((s) => s.view === "picture" && s.pictured === "relit" && s.map === "lit"),
      { name: "repeats", label: "Copies of the maps", type: "range", min: 1, max: 8, step: 1, value: 1, when: free },
      { name: "relief", label: "Displacement", type: "range", min: 0, max: 4, step: 0.1, value: 1, text: (x) => `${x.toFixed(1)} times`, when: free },
      { name: "told", label: notes.filter(Boolean).join(" "), type: "note" },
    ];
  }
}
VIEWERS.surface = SurfaceViewer;

// Return a picture as a texture of unchanged display values, row 0 at v = 0.
async function pictureTexture(address, tiles) {
  const wrap = tiles ? THREE.RepeatWrapping : THREE.ClampToEdgeWrapping, made = new THREE.Texture(await imageOf(address));
  return Object.assign(made, { wrapS: wrap, wrapT: wrap, flipY: false, minFilter: THREE.LinearMipmapLinearFilter, needsUpdate: true });
}
