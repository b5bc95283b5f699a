"""Functions that run shader code of a BRDF: C++ by the system's compiler, WGSL by wgpu, HLSL by slangpy.

Tests are skipped where these are missing. There is no compiler of OSL: with the definitions OSL_AS_CPP its code is
compiled as C++, which shows what it computes, but not that OSL accepts it.
"""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

Array = NDArray[np.float32]
C_LOOP = """
extern "C" void run(int n, const float* a, const float* b, float* out) {
    for (int i = 0; i < n; i++) {
        float3 wi(a[3 * i], a[3 * i + 1], a[3 * i + 2]), wo(b[3 * i], b[3 * i + 1], b[3 * i + 2]);
        float3 f = metapp::NAME_eval(wi, wo), s = metapp::NAME_sample(wo, wi);
        float row[7] = {f.x, f.y, f.z, metapp::NAME_pdf(wi, wo), s.x, s.y, s.z};
        for (int k = 0; k < 7; k++) out[7 * i + k] = row[k];
    }
}
"""
OSL_AS_CPP = """
#include <cmath>
#define shader inline void
#define output
#define float3 vector
struct vector {
    float x, y, z;
    vector(float x, float y, float z) : x(x), y(y), z(z) {}
    float operator[](int i) const { return i == 0 ? x : i == 1 ? y : z; }
};
struct color {
    color(float, float, float) {}
    color(float) {}
};
inline vector operator+(vector a, vector b) { return vector(a.x + b.x, a.y + b.y, a.z + b.z); }
inline vector operator-(vector a, vector b) { return vector(a.x - b.x, a.y - b.y, a.z - b.z); }
inline vector operator*(vector a, float b) { return vector(a.x * b, a.y * b, a.z * b); }
inline vector operator/(vector a, float b) { return vector(a.x / b, a.y / b, a.z / b); }
inline float dot(vector a, vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline float length(vector a) { return std::sqrt(dot(a, a)); }
inline vector normalize(vector a) { return a / length(a); }
namespace metapp {
inline float max(float a, float b) { return a > b ? a : b; }
inline float min(float a, float b) { return a < b ? a : b; }
inline float abs(float a) { return a < 0 ? -a : a; }
"""
WGSL_LOOP = """
@group(0) @binding(0) var<storage, read> a: array<f32>;
@group(0) @binding(1) var<storage, read> b: array<f32>;
@group(0) @binding(2) var<storage, read_write> result: array<f32>;
@compute @workgroup_size(64) fn main(@builtin(global_invocation_id) id: vec3u) {
    let i = id.x;
    if (i >= arrayLength(&a) / 3u) { return; }
    let wi = vec3f(a[3u * i], a[3u * i + 1u], a[3u * i + 2u]);
    let wo = vec3f(b[3u * i], b[3u * i + 1u], b[3u * i + 2u]);
    let f = NAME_eval(wi, wo);
    let s = NAME_sample(wo, wi);
    result[7u * i] = f.x; result[7u * i + 1u] = f.y; result[7u * i + 2u] = f.z;
    result[7u * i + 3u] = NAME_pdf(wi, wo);
    result[7u * i + 4u] = s.x; result[7u * i + 5u] = s.y; result[7u * i + 6u] = s.z;
}
"""
SLANG_LOOP = """
StructuredBuffer<float> a, b;
RWStructuredBuffer<float> result;
uniform uint n;
[shader("compute")][numthreads(64, 1, 1)]
void run(uint3 id: SV_DispatchThreadID) {
    uint i = id.x;
    if (i >= n) return;
    float3 wi = float3(a[3 * i], a[3 * i + 1], a[3 * i + 2]), wo = float3(b[3 * i], b[3 * i + 1], b[3 * i + 2]);
    float3 f = NAME_eval(wi, wo), s = NAME_sample(wo, wi);
    result[7 * i] = f.x; result[7 * i + 1] = f.y; result[7 * i + 2] = f.z;
    result[7 * i + 3] = NAME_pdf(wi, wo);
    result[7 * i + 4] = s.x; result[7 * i + 5] = s.y; result[7 * i + 6] = s.z;
}
"""


def run_cpp(code: str, name: str, first: Array, second: Array, folder: Path) -> Array:
    """Run C++ code by the system's compiler; return values, densities and sampled directions, [N, 7]."""
    compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler")
    (folder / "code.cpp").write_text(code.replace("#pragma once\n", "") + C_LOOP.replace("NAME", name))
    flags = ("-std=c++17", "-O2", "-Wall", "-Wno-unused-but-set-parameter", "-Werror", "-shared", "-fPIC")
    arguments = [compiler, *flags, "code.cpp", "-o", "code.so"]
    subprocess.run(arguments, cwd=folder, check=True, timeout=120)
    out = np.zeros((len(first), 7), np.float32)
    pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (first, second, out)]
    ctypes.CDLL(str(folder / "code.so")).run(len(first), *pointers)
    return out


def run_osl_as_cpp(code: str, name: str, first: Array, second: Array, folder: Path) -> Array:
    """Run OSL code as C++, with definitions of OSL's types and functions; return what `run_cpp` does."""
    return run_cpp(f"{OSL_AS_CPP}{code}}}\n", name, first, second, folder)


def run_wgsl(code: str, name: str, first: Array, second: Array, folder: Path) -> Array:
    """Run WGSL code by wgpu on any adapter, also one in software; return what `run_cpp` does."""
    wgpu = pytest.importorskip("wgpu")
    from wgpu.utils.compute import compute_with_buffers

    if not wgpu.gpu.enumerate_adapters_sync():
        pytest.skip("no adapter of wgpu")
    inputs = {0: first, 1: second}
    shape = (7 * len(first), "f")
    out = compute_with_buffers(inputs, {2: shape}, code + WGSL_LOOP.replace("NAME", name), n=-(-len(first) // 64))
    return np.frombuffer(out[2], np.float32).reshape(-1, 7)


def run_hlsl(code: str, name: str, first: Array, second: Array, folder: Path) -> Array:
    """Run HLSL code on the CPU by slangpy, whose Slang compiler reads HLSL; return what `run_cpp` does."""
    slangpy = pytest.importorskip("slangpy")
    device = slangpy.Device(type=slangpy.DeviceType.cpu, enable_hot_reload=False)
    module = device.load_module_from_source("code", code + SLANG_LOOP.replace("NAME", name))
    program = device.link_program([module], [module.entry_point("run")])
    usage = slangpy.BufferUsage.shader_resource | slangpy.BufferUsage.unordered_access
    buffers = [
        device.create_buffer(element_count=array.size, struct_size=4, usage=usage, data=array.ravel())
        for array in (first, second, np.zeros((len(first), 7), np.float32))
    ]
    kernel = device.create_compute_kernel(program)
    names = dict(zip(("a", "b", "result"), buffers, strict=True))
    kernel.dispatch(thread_count=[len(first), 1, 1], vars={**names, "n": len(first)})
    return buffers[2].to_numpy().view(np.float32).reshape(-1, 7)


RUNNERS = {"cpp": run_cpp, "osl": run_osl_as_cpp, "wgsl": run_wgsl, "hlsl": run_hlsl}
