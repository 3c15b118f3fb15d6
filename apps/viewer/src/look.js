// Light, sky and materials: what things look like, plain or coloured by a field.

import * as THREE from 'three';
import {meta} from './data.js';

export const sun = new THREE.Vector3(0.52, 0.62, 0.58).normalize();  // from the south-east, y up

/// Colours of values and of numbers that are names, as the renderer draws them.
function lookup(hex) {
    const n = hex.length / 6, data = new Uint8Array(n * 4);
    for (let i = 0; i < n; ++i) {
        for (let k = 0; k < 3; ++k) data[4 * i + k] = parseInt(hex.substr(6 * i + 2 * k, 2), 16);
        data[4 * i + 3] = 255;
    }
    const texture = new THREE.DataTexture(data, n, 1);
    texture.colorSpace = THREE.SRGBColorSpace;
    texture.needsUpdate = true;
    return texture;
}
const values = lookup(meta.colours.values), ids = lookup(meta.colours.ids);
values.magFilter = values.minFilter = THREE.LinearFilter;

const skyGlsl = /* glsl */`
    vec3 skyColour(vec3 d, vec3 sun, float glow) {
        float up = max(d.y, 0.0), s = max(dot(d, sun), 0.0);
        vec3 horizon = vec3(0.80, 0.83, 0.84), zenith = vec3(0.19, 0.36, 0.62);
        vec3 c = mix(horizon, zenith, 1.0 - exp(-2.6 * up));
        c += vec3(1.0, 0.86, 0.64) * (0.18 * pow(s, 6.0) + 0.5 * pow(s, 80.0) + glow * smoothstep(0.99985, 0.99995, s));
        return mix(c, vec3(0.73, 0.72, 0.69), smoothstep(0.0, -0.09, d.y));
    }`;

export function skyDome() {
    const dome = new THREE.Mesh(new THREE.SphereGeometry(1, 32, 16), new THREE.ShaderMaterial({
        side: THREE.BackSide, depthWrite: false, depthTest: false, uniforms: {sun: {value: sun}},
        vertexShader: 'varying vec3 d; void main() { d = position; vec4 p = projectionMatrix * mat4(mat3(modelViewMatrix)) * vec4(position, 1.0); gl_Position = p.xyww; }',
        fragmentShader: `varying vec3 d; uniform vec3 sun; ${skyGlsl}
            void main() { gl_FragColor = vec4(skyColour(normalize(d), sun, 6.0), 1.0);
            #include <tonemapping_fragment>
            #include <colorspace_fragment>
            }`,
    }));
    dome.frustumCulled = false;
    dome.renderOrder = -1;
    return dome;
}

const noiseGlsl = /* glsl */`
    float hash13(vec3 p) { p = fract(p * 0.1031); p += dot(p, p.zyx + 31.32); return fract((p.x + p.y) * p.z); }
    float noise3(vec3 p) {
        vec3 i = floor(p), f = fract(p); f = f * f * (3.0 - 2.0 * f);
        return mix(mix(mix(hash13(i), hash13(i + vec3(1, 0, 0)), f.x), mix(hash13(i + vec3(0, 1, 0)), hash13(i + vec3(1, 1, 0)), f.x), f.y),
                   mix(mix(hash13(i + vec3(0, 0, 1)), hash13(i + vec3(1, 0, 1)), f.x), mix(hash13(i + vec3(0, 1, 1)), hash13(i + vec3(1, 1, 1)), f.x), f.y), f.z);
    }
    float grain(vec3 p) { return 0.5 * noise3(p) + 0.3 * noise3(p * 2.7 + 3.1) + 0.2 * noise3(p * 7.3 + 8.7); }`;

/// What a kind of thing looks like close by: size of its grain [m], how it changes colour and relief.
const kGrain = {rock: [0.09, 0.42, 0.014], obstacle: [0.05, 0.25, 0.008], ground: [0.05, 0.35, 0.008], bark: [0.025, 0.5, 0.006]};

/// Dresses a material of the .glb: `kind` of its node, `uniforms` of the field it may show.
export function dress(material, kind, uniforms, simple) {
    const name = material.name, leaf = kind === 'leaves' || /^leaf/.test(name), moss = /^moss/.test(name);
    const Shaded = simple ? THREE.MeshLambertMaterial : THREE.MeshStandardMaterial;
    const dressed = kind === 'water' ? new Shaded({color: 0x0d2626, transparent: true, opacity: 0.9})
                                     : new Shaded({color: material.color, side: material.side, map: material.map ?? null});
    dressed.name = name;
    if (!simple) Object.assign(dressed, {metalness: 0, roughness: kind === 'water' ? 0.04 : Math.max(0.6, material.roughness ?? 1)});
    dressed.vertexColors = material.vertexColors;
    const grain = !simple && !leaf && !moss && kGrain[kind];
    dressed.customProgramCacheKey = () => [simple, kind === 'water', leaf, grain ? kind : ''].join();
    dressed.onBeforeCompile = shader => {
        Object.assign(shader.uniforms, uniforms);
        shader.vertexShader = shader.vertexShader
            .replace('#include <common>', `#include <common>
                attribute float field; attribute float ownAo; attribute float ownId;
                varying float vField; flat varying float vName; varying float vAo; flat varying float vId; varying vec3 vAt;`)
            .replace('#include <begin_vertex>', `#include <begin_vertex>
                vField = field; vName = field; vAo = ownAo; vId = ownId;
                vec4 at4 = vec4(transformed, 1.0);
                #ifdef USE_INSTANCING
                    at4 = instanceMatrix * at4;
                #endif
                vAt = (modelMatrix * at4).xyz;`);
        shader.fragmentShader = shader.fragmentShader
            .replace('#include <common>', `#include <common>
                uniform int uMode; uniform vec2 uRange; uniform sampler2D uValues, uIds; uniform vec2 uHas;
                varying float vField; flat varying float vName; varying float vAo; flat varying float vId; varying vec3 vAt;
                ${grain ? noiseGlsl : ''}${kind === 'water' ? noiseGlsl + skyGlsl + 'uniform vec3 uSun; uniform float uTrees;' : ''}`)
            .replace('#include <color_fragment>', `#include <color_fragment>
                ${grain ? `float own = uHas.y > 0.0 ? fract(vId * 0.61803398875) : 0.5;
                    float g = grain(vAt * ${(1 / grain[0]).toFixed(2)}), slow = noise3(vAt * ${(0.12 / grain[0]).toFixed(2)});
                    diffuseColor.rgb *= (1.0 + ${grain[1].toFixed(2)} * (g - 0.5)) * (0.86 + 0.28 * own) * (0.85 + 0.3 * slow);
                    diffuseColor.rgb = mix(diffuseColor.rgb, diffuseColor.rgb * vec3(1.10, 1.0, 0.86), slow * 0.7);` : ''}`)
            .replace('#include <normal_fragment_maps>', `#include <normal_fragment_maps>
                ${grain ? `{   // relief from the same grain, by its slope on the screen
                    vec3 px = dFdx(vAt), py = dFdy(vAt); float fade = exp(-length(px) / ${(0.25 * grain[0]).toFixed(4)});
                    vec3 n0 = normalize(cross(px, py)); float h = g * ${grain[2].toFixed(4)};
                    vec3 r1 = cross(py, n0), r2 = cross(n0, px); float det = dot(px, r1);
                    vec3 slope = sign(det) * (dFdx(h) * r1 + dFdy(h) * r2) / max(abs(det), 1e-9);
                    normal = normalize(normal - fade * (viewMatrix * vec4(slope, 0.0)).xyz); }` : ''}
                ${kind === 'water' ? `{ vec2 q = vAt.xz * 5.0; normal = normalize(normal + (viewMatrix * vec4(
                    0.02 * (noise3(vec3(q, 1.0)) - 0.5), 0.0, 0.02 * (noise3(vec3(q, 7.0)) - 0.5), 0.0)).xyz); }` : ''}`)
            .replace('#include <aomap_fragment>', `#include <aomap_fragment>
                if (uHas.x > 0.0) reflectedLight.indirectDiffuse *= mix(0.4, 1.0, clamp(vAo, 0.0, 1.0));
                ${leaf ? `reflectedLight.indirectDiffuse *= 1.5;
                    #if NUM_DIR_LIGHTS > 0
                    float through = max(-dot(normal, directionalLights[0].direction), 0.0);
                    reflectedLight.directDiffuse += through * directionalLights[0].color * BRDF_Lambert(diffuseColor.rgb * vec3(0.75, 0.95, 0.35));
                    #endif` : ''}`)
            .replace('#include <opaque_fragment>', `${kind === 'water' ? `{
                    vec3 v = normalize(vViewPosition), r = (vec4(reflect(-v, normal), 0.0) * viewMatrix).xyz;
                    float fresnel = 0.02 + 0.98 * pow(1.0 - clamp(dot(normal, v), 0.0, 1.0), 5.0);
                    vec3 mirrored = skyColour(normalize(r), uSun, 0.0);
                    mirrored = mix(mirrored, vec3(0.05, 0.075, 0.03), uTrees * (1.0 - smoothstep(0.3, 0.8, normalize(r).y)));
                    outgoingLight = mix(outgoingLight, mirrored, fresnel);
                    diffuseColor.a = mix(diffuseColor.a, 1.0, fresnel); }` : ''}
                #include <opaque_fragment>`)
            .replace('#include <colorspace_fragment>', `if (uMode > 0) {
                    float facing = abs(dot(normal, normalize(vViewPosition)));
                    float sky = 0.5 + 0.5 * (vec4(normal, 0.0) * viewMatrix).y;
                    vec3 c = uMode == 3 ? vec3(0.55) : uMode == 2
                        ? (vName < -0.5 ? vec3(0.12) : texelFetch(uIds, ivec2(int(vName + 0.5) % ${ids.image.width}, 0), 0).rgb)
                        : texture2D(uValues, vec2(clamp((vField - uRange.x) / max(uRange.y - uRange.x, 1e-30), 0.002, 0.998), 0.5)).rgb;
                    gl_FragColor = vec4(c * (0.62 + 0.16 * facing + 0.22 * sky), uMode == 3 ? gl_FragColor.a : 1.0);
                }
                #include <colorspace_fragment>`);
    };
    return dressed;
}

export const newUniforms = () => ({
    uMode: {value: 0}, uRange: {value: new THREE.Vector2(0, 1)}, uHas: {value: new THREE.Vector2()},
    uValues: {value: values}, uIds: {value: ids}, uSun: {value: sun}, uTrees: {value: 0},  // whether water mirrors trees
});

/// A disc of raked gravel for things that bring no ground, or of more ground around that which they bring; it fades into
/// the haze. `hole`: Box3 that it leaves free, or null; `colour`: of that ground.
export function plain(radius, simple, hole, colour) {
    const disc = new THREE.Mesh(new THREE.CircleGeometry(1, 96).rotateX(-Math.PI / 2), new (simple ? THREE.MeshLambertMaterial : THREE.MeshStandardMaterial)({
        color: colour ?? 0xcac7bf, transparent: true, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1}));
    disc.scale.setScalar(radius);
    const free = {value: hole ? new THREE.Vector4(hole.min.x, hole.min.z, hole.max.x, hole.max.z) : new THREE.Vector4(1, 1, 0, 0)};
    disc.material.onBeforeCompile = shader => {
        shader.uniforms.uFree = free;
        shader.vertexShader = shader.vertexShader.replace('#include <common>', '#include <common>\nvarying vec4 vDisc;')
            .replace('#include <begin_vertex>', '#include <begin_vertex>\nvDisc = vec4(position.xz, (modelMatrix * vec4(position, 1.0)).xz);');
        shader.fragmentShader = shader.fragmentShader.replace('#include <common>', '#include <common>\nvarying vec4 vDisc; uniform vec4 uFree;')
            .replace('#include <color_fragment>', `#include <color_fragment>
                if (all(greaterThan(vDisc.zw, uFree.xy)) && all(lessThan(vDisc.zw, uFree.zw))) discard;
                diffuseColor.a = 1.0 - smoothstep(0.25, 1.0, length(vDisc.xy));`);
    };
    disc.receiveShadow = true;
    disc.renderOrder = -0.5;
    return disc;
}
