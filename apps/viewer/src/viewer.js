// A page of `sekitei view`: turns the scene, switches fields, scrubs frames, explains what is clicked.

import * as THREE from 'three';
import {OrbitControls} from 'three/examples/jsm/controls/OrbitControls.js';
import {GLTFLoader} from 'three/examples/jsm/loaders/GLTFLoader.js';
import {glbOf, keepOnly, meta} from './data.js';
import {explainer} from './explain.js';
import {dress, newUniforms, plain, skyDome, sun} from './look.js';

const $ = id => document.getElementById(id);
const element = (tag, attributes = {}, ...children) => {
    const e = Object.assign(document.createElement(tag), attributes);
    e.append(...children);
    return e;
};

function fail(error) {
    console.error(error);
    document.documentElement.dataset.failed = '1';
    $('loading').hidden = true;
    $('error').hidden = false;
    $('error').querySelector('p').textContent = error?.message ?? String(error);
}
window.addEventListener('error', event => fail(event.error ?? event.message));
window.addEventListener('unhandledrejection', event => fail(event.reason));

// --- the canvas ------------------------------------------------------------------------------------------------

/// Whether the browser draws with its processor: then everything has to be cheap.
function slowDrawing(gl) {
    const told = gl.getExtension('WEBGL_debug_renderer_info');
    return /swiftshader|llvmpipe|software|basic render/i.test(gl.getParameter(told ? told.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
}

function newRenderer() {
    const probe = document.createElement('canvas').getContext('webgl2');
    if (!probe) throw new Error('this browser draws no WebGL 2; switch on hardware acceleration or try another one');
    const slow = slowDrawing(probe) && location.hash !== '#rich';  // to see what graphics cards draw, with patience
    probe.getExtension('WEBGL_lose_context')?.loseContext();
    const renderer = new THREE.WebGLRenderer({canvas: $('view'), antialias: !slow});
    renderer.toneMapping = THREE.NeutralToneMapping;
    renderer.toneMappingExposure = 1.1;
    renderer.shadowMap.type = THREE.PCFShadowMap;
    renderer.shadowMap.autoUpdate = false;
    renderer.info.autoReset = false;
    return [renderer, slow];
}

const [renderer, slow] = newRenderer();
const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera(34, 1, 0.01, 1000);
const controls = new OrbitControls(camera, renderer.domElement);
Object.assign(controls, {enableDamping: true, dampingFactor: 0.12, maxPolarAngle: 1.62, zoomToCursor: true});
const hemisphere = new THREE.HemisphereLight(0xd6e0ee, 0xa39c90, 2.2), sunlight = new THREE.DirectionalLight(0xffeed6, 3.0);
sunlight.shadow.bias = -0.0004;
scene.add(skyDome(), hemisphere, sunlight, sunlight.target);

const most = slow ? 2.5e6 : 5e7;  // triangles of copies
let world = null;  // the frame shown: {group, box, focus, parts, instances, triangles}
let disc = null, budget = 0, wanted = true, lastDrawn = 0, drawn = 0;  // wanted: nothing is drawn before the first frame is asked for

/// Draws soon; `all` says that the picture may have changed by more than the camera.
function invalidate(all) {
    if (all) renderer.shadowMap.needsUpdate = renderer.shadowMap.enabled;
    if (wanted) return;
    wanted = true;
    requestAnimationFrame(draw);
}

/// Copies that are drawn: as many as go smoothly while things move, all of them once they rest. Each model gets an even
/// part of the triangles; what a small one leaves goes to the larger ones. Returns the share of all that are drawn.
function share(triangles) {
    const parts = world.instances.filter(part => part.mesh.visible);
    parts.sort((a, b) => a.total * a.triangles - b.total * b.triangles);
    let left = triangles, all = 0, shown = 0;
    parts.forEach((part, i) => {
        const wanted = part.total * part.triangles, given = Math.min(wanted, left / (parts.length - i));
        part.mesh.count = Math.min(part.total, Math.max(1, Math.round(given / part.triangles)));
        left = Math.max(0, left - given);
        all += part.total;
        shown += part.mesh.count;
    });
    return all ? shown / all : 1;
}

function draw(time) {
    wanted = false;
    if (!world) return;
    const moving = controls.update();
    const fraction = share(budget);
    renderer.info.reset();
    renderer.render(scene, camera);
    if (slow) renderer.getContext().readPixels(0, 0, 1, 1, 6408, 5121, new Uint8Array(4));  // what it took, not what was asked
    ++drawn;
    const took = performance.now() - Math.max(time, lastDrawn);
    lastDrawn = performance.now();
    document.documentElement.dataset.frames = drawn;
    if (moving && document.documentElement.dataset.ready) {
        if (took > 90) {
            budget = Math.max(2e4, budget * 0.6);
            if (!coarse) sharpen(true);
        } else if (took < 30 && fraction < 1) budget *= 1.3;
        return invalidate();
    }
    if (coarse && document.documentElement.dataset.ready) {
        clearTimeout(draw.timer);
        draw.timer = setTimeout(() => { sharpen(false); invalidate(true); }, 250);
        return;
    }
    if (fraction < 1 && budget < most) {  // at rest: more and more copies, without holding up whoever moves next
        budget = Math.min(budget * 3, most);
        clearTimeout(draw.timer);
        draw.timer = setTimeout(() => invalidate(true), 60);
    } else if (document.documentElement.dataset.ready) document.documentElement.dataset.whole = drawn;
}

/// A mesh of some thousand triangles on the vertices of a large one: those in one cell of a lattice become one.
function coarseIndex(geometry) {
    const p = geometry.attributes.position.array, index = geometry.index.array, box = geometry.boundingBox, size = box.getSize(new THREE.Vector3());
    const edge = Math.max(size.x, size.y, size.z) / 110 || 1, ny = Math.floor(size.y / edge) + 1, nz = Math.floor(size.z / edge) + 1;
    const cells = new Int32Array((Math.floor(size.x / edge) + 1) * ny * nz).fill(-1), stands = new Uint32Array(p.length / 3);
    for (let v = 0, i = 0; v < stands.length; ++v, i += 3) {
        const cell = (((p[i] - box.min.x) / edge | 0) * ny + ((p[i + 1] - box.min.y) / edge | 0)) * nz + ((p[i + 2] - box.min.z) / edge | 0);
        if (cells[cell] < 0) cells[cell] = v;
        stands[v] = cells[cell];
    }
    const few = new Uint32Array(index.length);
    let n = 0;
    for (let i = 0; i < index.length; i += 3) {
        const a = stands[index[i]], b = stands[index[i + 1]], c = stands[index[i + 2]];
        if (a !== b && b !== c && c !== a) few[n++] = a, few[n++] = b, few[n++] = c;
    }
    return new THREE.BufferAttribute(few.slice(0, n), 1);
}

/// Fewer pixels and triangles while things move, where all of them take too long.
let coarse = slow;
function sharpen(less) {
    coarse = less;
    for (const part of world?.parts ?? []) if (part.few) part.mesh.geometry.setIndex(coarse ? part.few : part.full);
    renderer.setPixelRatio((slow ? 1 : Math.min(devicePixelRatio, 2)) * (coarse ? 0.5 : 1));
}

function resize() {
    const w = innerWidth, h = innerHeight;
    renderer.setSize(w, h, false);
    sharpen(coarse);
    camera.aspect = w / h;
    camera.updateProjectionMatrix();
    invalidate();
}
addEventListener('resize', resize);
controls.addEventListener('change', () => invalidate());

// --- a frame ---------------------------------------------------------------------------------------------------

const loader = new GLTFLoader();
const stem = name => name.replace(/^_/, '').toLowerCase();
/// Numbers that only tell things apart, of no use as colours.
const kPlumbing = /^(moss_id|seed_id|id|site|host|variant|model|skeleton|face|interior|ball|branch_id|tree|part|s|suit)$/;

/// Attributes of instances are in file order; drawn are the first few of them, which shall stand everywhere.
function scatter(mesh) {
    const n = mesh.count;
    if (n < 64) return;
    let step = Math.floor(n * 0.6180339887) | 1;
    const divides = (a, b) => b ? divides(b, a % b) : a;
    while (divides(step, n) !== 1) step += 2;
    const order = new Uint32Array(n);
    for (let i = 0, at = 0; i < n; ++i, at = (at + step) % n) order[i] = at;
    const sort = attribute => {
        const width = attribute.itemSize, from = attribute.array.slice(), to = attribute.array;
        for (let i = 0; i < n; ++i) for (let k = 0; k < width; ++k) to[i * width + k] = from[order[i] * width + k];
    };
    sort(mesh.instanceMatrix);
    for (const [name, attribute] of Object.entries(mesh.geometry.attributes))
        if (attribute.isInstancedBufferAttribute && !attribute.sorted) {
            attribute.array = attribute.array.slice();  // views of the file's bytes may be shared
            sort(attribute);
            attribute.sorted = true;
        }
}

async function loadWorld(index) {
    const bytes = await glbOf(meta.frames[index]);
    performance.mark('unpacked');
    const gltf = await loader.parseAsync(bytes, '');
    performance.mark('parsed');
    const told = gltf.parser.json.asset?.extras?.sekitei ?? {}, group = gltf.scene;
    const result = {group, index, told, parts: [], instances: [], fields: new Map(), triangles: 0, copies: 0, copied: 0};
    const box = new THREE.Box3(), focus = new THREE.Box3(), stones = new THREE.Box3();
    let ground = null, feet = Infinity;
    group.updateMatrixWorld(true);
    const meshes = [];
    group.traverse(o => o.isMesh && meshes.push(o));
    for (const mesh of meshes) {
        const extras = mesh.userData.sekitei ?? mesh.parent?.userData.sekitei ?? {};
        const kind = extras.kind ?? (/leaf|leaves/.test(mesh.material.name) ? 'leaves' : mesh.isInstancedMesh ? 'instances' : 'rock');
        const geometry = mesh.geometry, triangles = (geometry.index ?? geometry.attributes.position).count / 3;
        if (!geometry.attributes.normal) geometry.computeVertexNormals();
        const part = {mesh, extras, kind, triangles, uniforms: newUniforms(), attributes: new Map(), plain: null,
                      layer: mesh.isInstancedMesh ? extras.set ?? 'copies' : kind === 'leaves' ? 'leaves' : kind};
        for (const [name, attribute] of Object.entries(geometry.attributes))
            if (name.startsWith('_') && attribute.itemSize === 1 && attribute.isInstancedBufferAttribute === !!mesh.isInstancedMesh || name.startsWith('_') && attribute.itemSize === 1 && !mesh.isInstancedMesh)
                part.attributes.set(stem(name), attribute);
        for (const own of ['column_id', 'component']) if (part.attributes.has(own) && !geometry.attributes.ownId) geometry.setAttribute('ownId', part.attributes.get(own));
        if (part.attributes.has('sky_view') && !mesh.isInstancedMesh) geometry.setAttribute('ownAo', part.attributes.get('sky_view'));
        part.uniforms.uHas.value.set(geometry.attributes.ownAo ? 1 : 0, geometry.attributes.ownId ? 1 : 0);
        mesh.material = dress(mesh.material, kind, part.uniforms, slow);
        for (const name of part.attributes.keys()) {
            if (kPlumbing.test(name)) continue;
            const field = result.fields.get(name) ?? {name, parts: [], ...infoOf(told, name)};
            field.parts.push(part);
            result.fields.set(name, field);
        }
        const own = new THREE.Box3();
        if (mesh.isInstancedMesh) {
            scatter(mesh);
            mesh.frustumCulled = false;
            part.total = mesh.count;
            result.instances.push(part);
            result.copies += mesh.count;
            result.copied += mesh.count * triangles;
            const m = mesh.instanceMatrix.array, one = new THREE.Box3(), matrix = new THREE.Matrix4();
            if (!geometry.boundingBox) geometry.computeBoundingBox();
            // Of many the first thousands will do: scatter() has mixed them.
            for (let i = 0; i < Math.min(m.length, 16 * 4000); i += 16) own.union(one.copy(geometry.boundingBox).applyMatrix4(matrix.fromArray(m, i)));
            own.applyMatrix4(mesh.matrixWorld);
            if (part.layer === 'forest') feet = Math.min(feet, own.min.y);
        } else {
            if (!geometry.boundingBox) geometry.computeBoundingBox();
            if (slow && geometry.index && triangles > 1.2e5) {
                part.full = geometry.index;
                part.few = coarseIndex(geometry);
                if (coarse) geometry.setIndex(part.few);
            }
            own.copy(geometry.boundingBox).applyMatrix4(mesh.matrixWorld);
            result.triangles += triangles;
        }
        if (kind === 'ground' && own.getSize(new THREE.Vector3()).length() > (ground?.box.getSize(new THREE.Vector3()).length() ?? 0)) ground = {box: own, mesh};
        box.union(own);
        if (kind !== 'ground' && kind !== 'water' && part.layer !== 'forest') focus.union(own);
        if (kind === 'rock' || kind === 'obstacle') stones.union(own);
        mesh.castShadow = kind !== 'water' && kind !== 'ground';
        mesh.receiveShadow = kind !== 'leaves';
        result.parts.push(part);
    }
    if (!meshes.length || box.isEmpty()) throw new Error(`${meta.frames[index].file}: nothing to draw`);
    Object.assign(result, {box, stones});
    result.focus = !stones.isEmpty() ? stones : !focus.isEmpty() ? focus : box;  // trees may reach out of the picture
    Object.assign(result, {ground, feet});
    for (const part of result.parts) part.uniforms.uTrees.value = result.parts.some(p => p.layer === 'forest') ? 1 : 0;
    return result;
}

const kNames = new Set(['column_id', 'column', 'component', 'surface', 'moss_species', 'species', 'geology', 'zone', 'part', 'variant', 'model', 'region', 'kind']);
const kWords = {column_id: 'column', component: 'piece', surface: 'face of rock', light_s: 'light', light_direct: 'light, direct', light_sky: 'light of the sky',
    light_reflected: 'light, reflected', light_indirect: 'light, indirect', sky_view: 'sky view', rain_exposure: 'rain exposure', soil_ts: 'surface temperature',
    soil_rh: 'surface humidity', soil_theta: 'water content', soil_beta: 'evaporation share', soil_e: 'evaporation', soil_runoff: 'runoff', soil_water: 'water',
    soil_h: 'depth of soil', moss_cover: 'moss cover', moss_species: 'moss species', moss_growth: 'moss growth', moss_age: 'moss age', temperature: 'temperature'};

/// Name, unit and range of an attribute, as the file tells them.
function infoOf(told, name) {
    const entry = Object.entries(told.fields ?? {}).find(([key]) => stem(key) === name)?.[1] ?? {};
    const word = kWords[name] ?? (entry.name ?? name).replace(/^wind_ratio_(\d)$/, (_, k) => `wind from ${['N', 'NE', 'E', 'SE', 'S', 'SW', 'W', 'NW'][k]}`).replace(/^suit_/, 'fitness of ').replaceAll('_', ' ');
    return {word, unit: (entry.unit ?? '').replace(/\^2|(?<=m)2\b/, '\u00b2').replace('^3', '\u00b3'), low: entry.low, high: entry.high, names: kNames.has(name)};
}

/// Range of a field in this frame where the file tells none.
function rangeOf(field) {
    if (Number.isFinite(field.low) && Number.isFinite(field.high)) return [field.low, field.high];
    let low = Infinity, high = -Infinity;
    for (const part of field.parts) for (const v of part.attributes.get(field.name).array) { if (v < low) low = v; if (v > high) high = v; }
    return [field.low, field.high] = low <= high ? [low, high] : [0, 1];
}

// --- fields ----------------------------------------------------------------------------------------------------

let fieldShown = '';
const hiddenLayers = new Set();
const nice = v => v === 0 ? '0' : Math.abs(v) >= 1e4 || Math.abs(v) < 1e-3 ? v.toExponential(2) : String(Number(v.toPrecision(4)));

/// The range over all frames that are known, so that colours mean the same on each day.
const ranges = new Map();

function showField(name) {
    fieldShown = name;
    const field = world.fields.get(name);
    const [low, high] = field ? rangeOf(field) : [0, 1];
    if (field) {
        const over = ranges.get(name) ?? [low, high];
        ranges.set(name, [Math.min(over[0], low), Math.max(over[1], high)]);
    }
    const range = ranges.get(name) ?? [low, high];
    for (const part of world.parts) {
        const attribute = field && part.attributes.get(name);
        part.uniforms.uMode.value = !field ? 0 : !attribute ? 3 : field.names ? 2 : 1;
        part.uniforms.uRange.value.set(range[0], range[1]);
        if (attribute) part.mesh.geometry.setAttribute('field', attribute);
        // Plants would hide the field of what they stand on.
        part.covered = !!field && !attribute && (part.mesh.isInstancedMesh || part.kind === 'leaves');
    }
    showLayers();
    $('bar').hidden = !field;
    if (field) {
        $('bar').classList.toggle('names', field.names);
        $('low').textContent = field.names ? '' : nice(range[0]);
        $('high').textContent = field.names ? '' : nice(range[1]);
        $('unit').textContent = field.names ? 'one colour each' : field.unit || 'no unit';
        const names = name === 'moss_species' ? ['none', ...world.told.species ?? []] : name === 'species' ? world.told.species : null;
        $('key').replaceChildren(...field.names && names ? names.map((n, i) =>
            element('span', {}, element('i', {style: `background:#${meta.colours.ids.substr(6 * i, 6)}`}), n)) : []);
    }
    for (const button of $('fields').children) button.setAttribute('aria-pressed', button.dataset.field === name);
    document.documentElement.dataset.field = name;
    invalidate(true);
}

function showLayers() {
    for (const part of world.parts) part.mesh.visible = !hiddenLayers.has(part.layer) && !part.covered;
    if (disc) disc.visible = !hiddenLayers.has('plain');
    invalidate(true);
}

const kOrder = ['column_id', 'temperature', 'light_s', 'soil_ts', 'soil_rh', 'moss_cover', 'moss_species', 'moss_growth'];
const rank = name => kOrder.includes(name) ? kOrder.indexOf(name) : 100;

function fillPanel() {
    const fields = [...world.fields.values()].sort((a, b) => rank(a.name) - rank(b.name) || (a.word < b.word ? -1 : 1));
    const button = (name, word, unit) => {
        const b = element('button', {type: 'button', onclick: () => showField(name)}, word, element('small', {textContent: unit}));
        b.dataset.field = name;
        return b;
    };
    $('fields').replaceChildren(button('', 'as it looks', ''), ...fields.map(f => button(f.name, f.word, f.unit)));
    const layers = [...new Set(world.parts.map(p => p.layer)), ...disc ? ['plain'] : []];
    $('layers').replaceChildren(...layers.map(layer => {
        const box = element('input', {type: 'checkbox', checked: !hiddenLayers.has(layer), onchange: () => {
            box.checked ? hiddenLayers.delete(layer) : hiddenLayers.add(layer);
            for (const p of world.parts) if (p.layer === layer && box.checked) p.covered = false;
            showLayers();
        }});
        return element('label', {}, box, layer.replace('_', ' '));
    }));
    $('layers').parentElement.hidden = layers.length < 2;
    const n = v => v >= 1e6 ? (v / 1e6).toPrecision(3) + ' M' : v >= 1e4 ? Math.round(v / 1e3) + ' k' : String(Math.round(v));
    $('count').textContent = `${n(world.triangles)} triangles` + (world.copies ? `, ${n(world.copies)} plants` : '');
}

// --- camera ----------------------------------------------------------------------------------------------------

/// From where the fewest boughs and leaves stand between the eye and the stones: from the south, or from beside it.
function clearView(box, distance) {
    const views = [0.42, 0.05, -0.35, 0.8, -0.75, 1.4, -1.4].map(x => new THREE.Vector3(x, 0.34, 1).normalize());
    if (world.focus !== world.stones) return views[0];
    const centre = box.getCenter(new THREE.Vector3()), reach = box.getSize(new THREE.Vector3()).length() / 2;
    let best = views[0], least = Infinity;
    for (const view of views) {
        let hidden = 0;
        for (const part of world.parts) {
            if (part.kind !== 'bark' && part.layer !== 'leaves') continue;
            const list = part.mesh.isInstancedMesh ? part.mesh.instanceMatrix.array : part.mesh.geometry.attributes.position.array;
            const [step, from] = part.mesh.isInstancedMesh ? [16, 12] : [3, 0];
            for (let i = from; i < list.length; i += step) {
                const x = list[i] - centre.x, y = list[i + 1] - centre.y, z = list[i + 2] - centre.z;
                const along = x * view.x + y * view.y + z * view.z, ahead = distance - along;
                if (along < 0.5 * reach || ahead < -0.3) continue;
                const aside = Math.sqrt(Math.max(0, x * x + y * y + z * z - along * along)), near = Math.max(ahead, 0.3);
                if (aside < reach * near / distance + 0.3) hidden += 1 / (near * near);
            }
        }
        if (hidden < 0.7 * least) least = hidden, best = view;
    }
    return best;
}

function fit(direction = null) {
    const box = world.focus, size = box.getSize(new THREE.Vector3()), all = world.box.getSize(new THREE.Vector3()).length();
    const centre = box.getCenter(new THREE.Vector3()), reach = size.length() / 2;
    direction ??= clearView(box, size.length() * 1.15);
    // So far that every corner of its box is inside the picture.
    const back = direction.clone().normalize(), right = new THREE.Vector3(0, 1, 0).cross(back).normalize(), up = back.clone().cross(right);
    const high = Math.tan(camera.fov * Math.PI / 360) * (meta.frames.length > 1 ? 0.82 : 0.9), wide = Math.tan(camera.fov * Math.PI / 360) * camera.aspect * (innerWidth > 900 ? 0.72 : 0.95);
    let distance = reach * 0.2;
    for (let i = 0; i < 8; ++i) {
        const corner = new THREE.Vector3(i & 1 ? box.min.x : box.max.x, i & 2 ? box.min.y : box.max.y, i & 4 ? box.min.z : box.max.z).sub(centre);
        distance = Math.max(distance, corner.dot(back) + Math.max(Math.abs(corner.dot(right)) / wide, Math.abs(corner.dot(up)) / high));
    }
    camera.position.copy(centre).addScaledVector(back, distance);
    camera.near = reach / 400;
    camera.far = distance + all * 12 + reach * 40;
    camera.updateProjectionMatrix();
    if (meta.frames.length > 1) {  // room for the slider
        const down = distance * 0.02;
        centre.y -= down;
        camera.position.y -= down;
    }
    controls.target.copy(centre);
    controls.minDistance = reach / 60;
    controls.maxDistance = all * 4 + distance;
    controls.update();
    // Shadows reach over what is looked at.
    const far = Math.min(world.box.getSize(new THREE.Vector3()).length() / 2, reach * 2.2);
    sunlight.target.position.copy(centre);
    sunlight.position.copy(centre).addScaledVector(sun, far * 2);
    Object.assign(sunlight.shadow.camera, {left: -far, right: far, top: far, bottom: -far, near: far * 0.1, far: far * 4});
    sunlight.shadow.camera.updateProjectionMatrix();
    sunlight.shadow.normalBias = far / 700;
    invalidate(true);
}

// --- what is clicked -------------------------------------------------------------------------------------------

const ray = new THREE.Raycaster(), marker = new THREE.Mesh(new THREE.SphereGeometry(1, 16, 12),
    new THREE.MeshBasicMaterial({color: 0xd6402c, depthTest: false, transparent: true, opacity: 0.9, toneMapped: false}));
marker.visible = false;
marker.renderOrder = 10;
scene.add(marker);
const tables = new Map();  // of each frame, once asked for

function hitAt(x, y) {
    ray.setFromCamera(new THREE.Vector2(x / innerWidth * 2 - 1, 1 - y / innerHeight * 2), camera);
    const hits = ray.intersectObjects(world.parts.filter(p => p.mesh.visible).map(p => p.mesh), false);
    return hits.length ? hits[0] : null;
}

const row = (label, value, unit = '') => element('tr', {className: label.startsWith('  ') ? 'sub' : ''},
    element('th', {textContent: label.trim()}), element('td', {textContent: value}), element('td', {className: 'unit', textContent: unit}));

/// Numbers of one copy: a moss, a tree, a leaf.
function tellCopy(part, index) {
    const {extras} = part, value = name => part.attributes.get(name)?.array[index];
    const ids = part.mesh.geometry.attributes._ID ?? part.mesh.geometry.attributes._id;
    const rows = [];
    if (extras.species) rows.push(row('species', extras.species));
    if (ids) rows.push(row('id', String(ids.itemSize === 2 ? ids.array[2 * index] + ids.array[2 * index + 1] * 2 ** 24 : ids.array[index])));
    for (const [name, attribute] of part.attributes) if (name !== 'id' && !(name === 'species' && extras.species)) {
        const info = infoOf(world.told, name);
        rows.push(row(info.word, nice(attribute.array[index]), info.unit));
    }
    if (extras.prototype) rows.push(row('model', extras.prototype));
    const m = new THREE.Matrix4();
    part.mesh.getMatrixAt(index, m);
    const p = new THREE.Vector3().setFromMatrixPosition(m).applyMatrix4(part.mesh.matrixWorld);
    const box = part.mesh.geometry.boundingBox ?? (part.mesh.geometry.computeBoundingBox(), part.mesh.geometry.boundingBox);
    if (value('height') === undefined) rows.push(row('height', nice(box.clone().applyMatrix4(m).getSize(new THREE.Vector3()).y), 'm'));
    rows.push(row('stands at', [p.x, -p.z, p.y].map(v => v.toFixed(2)).join(', '), 'm'));
    const what = extras.set === 'forest' ? 'tree' : extras.set === 'leaves' ? 'leaf' : extras.set === 'moss' ? 'moss' : 'copy';
    return element('section', {className: 'copy'}, element('h3', {textContent: what}), element('table', {}, ...rows));
}

function tellPlace(t, away, position, file) {
    const parts = [];
    parts.push(element('p', {className: 'where'}, `${t.name} at ${t.at.join(', ')} m`,
        element('br'), `normal ${t.normal.join(', ')}; area ${t.area} cm\u00b2`));
    if (away > 0.5) parts.push(element('p', {className: 'note', textContent: `The nearest place with a climate is ${nice(away)} m away.`}));
    const rows = [];
    for (const m of t.measures) {
        rows.push(row(m.label, m.text, m.unit.replace('m2', 'm\u00b2')));
        if (m.name === 'wind_speed') rows.push(element('tr', {className: 'sub'}, element('td', {colSpan: 3, className: 'rose', textContent: t.wind.map(w => `${w.from} ${w.text}`).join('  ')})));
    }
    if (rows.length) parts.push(element('h3', {textContent: 'climate, means over the days'}), element('table', {}, ...rows));
    if (t.species.length) {
        parts.push(element('h3', {textContent: 'fitness G = temperature \u00d7 humidity \u00d7 light \u00d7 gate'}));
        for (const s of t.species) {
            const bars = ['temperature', 'humidity', 'light', 'gate'].map((name, k) => element('div', {className: 'factor' + (k === s.limits ? ' limits' : '')},
                element('span', {textContent: name}), element('i', {}, element('b', {style: `width:${100 * Math.min(1, Math.max(0, s.factors[k]))}%`})), element('em', {textContent: s.factors[k]})));
            parts.push(element('div', {className: 'species' + (s.grows ? ' grows' : '')},
                element('header', {}, element('strong', {textContent: s.name}), element('em', {textContent: `G ${s.G}`})), ...bars,
                element('p', {textContent: (s.grows ? `grows; ${s.limiting} limits` : `too little to grow: ${s.limiting} limits`) + (s.mean ? `; mean of every day's G ${s.mean}` : '')})));
        }
    }
    if (t.growing) parts.push(element('p', {className: 'growing', textContent: t.growing.length
        ? t.growing.map(g => `on it: ${g.name}, growth ${g.growth}, ${g.days} days old`).join('\n') : 'on it: no moss'}));
    parts.push(element('code', {className: 'command', textContent: `sekitei explain ${file} --at ${position.map(v => Number(v.toFixed(9))).join(',')}`}));
    return parts;
}

async function explain(x, y) {
    const hit = hitAt(x, y);
    if (!hit) return closePanel();
    const part = world.parts.find(p => p.mesh === hit.object), frame = meta.frames[world.index];
    marker.position.copy(hit.point);
    marker.visible = true;
    marker.scale.setScalar(camera.position.distanceTo(hit.point) * 0.006);
    const content = [];
    if (part.mesh.isInstancedMesh) content.push(tellCopy(part, hit.instanceId));
    else content.push(element('p', {className: 'kind', textContent: part.mesh.name.replaceAll('_', ' ')}));
    if (frame.explain) {
        if (!tables.has(world.index)) tables.set(world.index, explainer(frame.explain));
        const table = await tables.get(world.index), p = [hit.point.x, -hit.point.z, hit.point.y];
        const {place, away} = table.nearest(p);
        content.push(...tellPlace(table.tell(place), away, table.position(place), frame.explain.file));
        Object.assign($('explain').dataset, {place, point: p.map(v => v.toFixed(9)).join(',')});
    } else {
        const rows = [];
        if (!part.mesh.isInstancedMesh)
            for (const [name, attribute] of part.attributes) {
                const info = infoOf(world.told, name), value = attribute.array[hit.face.a];
                rows.push(row(info.word, nice(value), info.unit));
            }
        content.push(element('table', {}, ...rows), element('p', {className: 'note', textContent: 'This scene has no climate to explain.'}));
    }
    $('told').replaceChildren(...content);
    $('explain').hidden = false;
    $('explain').scrollTop = 0;
    invalidate();
}

function closePanel() {
    $('explain').hidden = true;
    delete $('explain').dataset.place;
    marker.visible = false;
    invalidate();
}

let down = null;
renderer.domElement.addEventListener('pointerdown', e => { down = e.isPrimary ? [e.clientX, e.clientY] : null; });
renderer.domElement.addEventListener('pointerup', e => {
    if (down && e.button === 0 && Math.hypot(e.clientX - down[0], e.clientY - down[1]) < 5) explain(e.clientX, e.clientY).catch(fail);
    down = null;
});

// --- frames ----------------------------------------------------------------------------------------------------

let playing = 0, loading = null;

function dispose(old) {
    scene.remove(old.group);
    for (const part of old.parts) { part.mesh.geometry.dispose(); part.mesh.material.dispose(); part.mesh.dispose?.(); }
}

async function show(index) {
    while (loading) await loading;
    if (world?.index === index) return;
    loading = (async () => {
        const next = await loadWorld(index), first = !world;
        if (world) dispose(world);
        world = next;
        scene.add(world.group);
        const used = new Set();
        const note = frame => { used.add(frame.glb.json); for (const v of frame.glb.views) used.add(v.block); };
        note(meta.frames[index]);
        keepOnly(used);
        if (first) {
            const size = world.box.getSize(new THREE.Vector3()), own = world.ground?.box.getSize(new THREE.Vector3());
            if (!own || own.x < 0.7 * size.x || own.z < 0.7 * size.z) {
                const reach = (own ? world.box : world.focus).getSize(new THREE.Vector3()).length();
                disc = plain(reach * 3, slow, world.ground?.box, world.ground?.mesh.material.color);
                (own ? world.box : world.focus).getCenter(disc.position).setY(own ? Math.min(world.feet, world.ground.box.max.y) : world.box.min.y);
                scene.add(disc);
            }
            budget = slow ? 3e5 : 4e6;
            fit();
        }
        fillPanel();
        showField(world.fields.has(fieldShown) ? fieldShown : '');
        if (!first && !$('explain').hidden) closePanel();
        $('moment').textContent = meta.frames[index].label;
        $('slider').value = index;
        document.documentElement.dataset.frame = index;
    })();
    try { await loading; } finally { loading = null; }
}

function play(on) {
    playing = on ? playing + 1 : 0;
    $('play').setAttribute('aria-pressed', !!on);
    $('play').textContent = on ? '\u275a\u275a' : '\u25b6';
    const mine = playing, step = async () => {
        if (playing !== mine || !mine) return;
        const started = performance.now();
        await show((world.index + 1) % meta.frames.length);
        setTimeout(() => step().catch(fail), Math.max(30, 600 - (performance.now() - started)));
    };
    if (on) step().catch(fail);
}

function stepFrame(by) {
    play(false);
    show(Math.min(meta.frames.length - 1, Math.max(0, world.index + by))).catch(fail);
}

function stepField(by) {
    const names = [...$('fields').children].map(b => b.dataset.field);
    showField(names[(names.indexOf(fieldShown) + by + names.length) % names.length]);
}

// --- keys and buttons ------------------------------------------------------------------------------------------

addEventListener('keydown', event => {
    if (event.ctrlKey || event.metaKey || event.altKey || !world) return;
    const step = 0.08, offset = new THREE.Vector3().subVectors(camera.position, controls.target), turn = new THREE.Spherical().setFromVector3(offset);
    const actions = {
        f: () => fit(), '[': () => stepField(-1), ']': () => stepField(1), '0': () => showField(''), h: () => document.body.classList.toggle('bare'),
        '?': () => $('help').hidden = !$('help').hidden, Escape: () => { closePanel(); $('help').hidden = true; },
        ' ': () => meta.frames.length > 1 && play(!playing), ',': () => stepFrame(-1), '.': () => stepFrame(1),
        ArrowLeft: () => turn.theta -= step, ArrowRight: () => turn.theta += step, ArrowUp: () => turn.phi -= step, ArrowDown: () => turn.phi += step,
        '+': () => turn.radius *= 0.9, '=': () => turn.radius *= 0.9, '-': () => turn.radius /= 0.9,
    };
    if (!actions[event.key] || event.target.id === 'slider' && event.key.startsWith('Arrow')) return;
    event.preventDefault();
    actions[event.key]();
    if (/^Arrow|[-+=]/.test(event.key)) {
        turn.phi = Math.min(controls.maxPolarAngle, Math.max(0.05, turn.phi));
        camera.position.setFromSpherical(turn).add(controls.target);
        invalidate();
    }
});
$('fit').onclick = () => fit();
$('helpbutton').onclick = () => $('help').hidden = !$('help').hidden;
$('close').onclick = closePanel;
$('fold').onclick = () => { const folded = $('panel').classList.toggle('folded'); $('fold').setAttribute('aria-expanded', !folded); };
$('play').onclick = () => play(!playing);
$('slider').oninput = () => { play(false); show(Number($('slider').value)).catch(fail); };

async function start() {
    $('title').textContent = document.title = meta.title;
    const many = meta.frames.length > 1;
    $('time').hidden = !many;
    $('slider').max = meta.frames.length - 1;
    $('ticks').replaceChildren(...many ? [meta.frames[0].label, meta.frames.at(-1).label].map(t => element('span', {textContent: t})) : []);
    $('bar').querySelector('.ramp').style.background = `linear-gradient(90deg, ${Array.from({length: 32}, (_, i) =>
        '#' + meta.colours.values.substr(6 * Math.round(i / 31 * (meta.colours.values.length / 6 - 1)), 6)).join(',')})`;
    if (matchMedia('(max-width: 700px)').matches) $('fold').click();
    resize();
    await show(meta.start ?? 0);
    performance.mark('ready to draw');
    // The first picture: before shadows, with as many copies as go quickly.
    draw(performance.now());
    wanted = true;
    await new Promise(requestAnimationFrame);
    document.documentElement.dataset.firstFrame = Math.round(performance.now());
    $('loading').hidden = true;
    wanted = false;
    if (world.triangles + Math.min(world.copied, most) < (slow ? 6e5 : 4e7)) {
        renderer.shadowMap.enabled = sunlight.castShadow = true;
        sunlight.shadow.mapSize.setScalar(slow ? 1024 : 4096);
        for (const part of world.parts) part.mesh.material.needsUpdate = true;
    }
    invalidate(true);
    document.documentElement.dataset.ready = '1';
}
start().catch(fail);
