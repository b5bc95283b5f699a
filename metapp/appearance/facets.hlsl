// HLSL that every shader of a BRDF contains: exports translate it (metapp.extensions.shaders), and the viewer's page has GLSL
// read it by a macro (scripts/shading.js). Densities and samples are those of metapp.appearance.lobes.

float NAME_expm1(float x) {
    if (abs(x) < 0.01) {
        return x * (1.0 + x * (0.5 + x / 6.0));
    }
    return exp(x) - 1.0;
}

// Sine of theta_h, cosine and sine of phi_h.
float3 NAME_azimuth(float3 h) {
    float square = h.x * h.x + h.y * h.y;
    if (square <= 0.0) {
        return float3(0.0, 1.0, 0.0);
    }
    float sine = sqrt(square);
    return float3(sine, h.x / sine, h.y / sine);
}

// The difference vector of wi, turned by -phi_h and -theta_h; len is that of wi + wo.
float3 NAME_difference(float3 wi, float3 h, float len) {
    float3 angle = NAME_azimuth(h);
    float x = angle.y * wi.x + angle.z * wi.y;
    return float3(h.z * x - angle.x * wi.z, angle.y * wi.y - angle.z * wi.x, 0.5 * len);
}

// Density of a mirror at those facets of GGX roughness alpha that are visible from wo; wi may be below the surface.
float NAME_facets(float3 wi, float3 wo, float3 alpha) {
    float3 total = wi + wo;
    if (total.z <= 0.0) {
        return 0.0;
    }
    float3 h = normalize(total);
    float3 scaled = float3(h.x / alpha.x, h.y / alpha.y, h.z);
    float spread = dot(scaled, scaled);
    float slope = length(float3(alpha.x * wo.x, alpha.y * wo.y, wo.z));
    return 1.0 / (2.0 * PI * alpha.x * alpha.y * spread * spread * (wo.z + slope));
}

// A facet that is visible from wo, of two numbers in [0, 1) (Dupuy and Benyoub 2023).
float3 NAME_facet(float3 wo, float3 alpha, float u, float v) {
    float3 stretched = normalize(float3(alpha.x * wo.x, alpha.y * wo.y, wo.z));
    float z = (1.0 - u) * (1.0 + stretched.z) - stretched.z;
    float sine = sqrt(max(0.0, 1.0 - z * z));
    float phi = 2.0 * PI * v;
    float3 cap = float3(sine * cos(phi), sine * sin(phi), z) + stretched;
    return normalize(float3(alpha.x * cap.x, alpha.y * cap.y, max(cap.z, 1e-6)));
}
