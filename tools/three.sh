#!/usr/bin/env bash
# Makes metapp/extensions/viewer/three.min.js anew: the parts of three.js that pages use, of a pinned version. Needs npm.
set -euo pipefail
cd "$(dirname "$0")/.."
three=0.187.0
esbuild=0.28.2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
(cd "$work" && npm install --silent --no-fund --no-audit "three@$three" "esbuild@$esbuild" && node node_modules/esbuild/install.js)
cat > "$work/parts.js" <<'JS'
export {
  BufferAttribute, BufferGeometry, ClampToEdgeWrapping, ColorManagement, Data3DTexture, DataTexture, DataUtils, DoubleSide, FloatType, GLSL3,
  HalfFloatType, LinearFilter, LinearMipmapLinearFilter, LinearSRGBColorSpace, Matrix4, Mesh, NearestFilter, NoBlending,
  OrthographicCamera, PerspectiveCamera, RawShaderMaterial, RepeatWrapping, RGBAFormat, Scene, Texture, Vector2,
  Vector3, Vector4, WebGLRenderTarget, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
export { HDRLoader } from "three/addons/loaders/HDRLoader.js";
JS
(cd "$work" && node_modules/.bin/esbuild parts.js --bundle --minify --format=iife --global-name=THREE \
  --banner:js="/* three.js $three, MIT licence, Copyright 2010-2026 three.js authors: LICENSE.three */" --outfile=three.min.js)
grep -qi '</script' "$work/three.min.js" && { echo "three.sh: the bundle ends a script element" >&2; exit 1; }
cp "$work/three.min.js" metapp/extensions/viewer/three.min.js
cp "$work/node_modules/three/LICENSE" metapp/extensions/viewer/LICENSE.three
ls -l metapp/extensions/viewer/three.min.js
