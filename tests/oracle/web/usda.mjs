// node usda.mjs FILE.usda: what three.js's parser finds in it, as JSON.
import {readFileSync} from 'node:fs';
import {USDAParser} from 'three/examples/jsm/loaders/usd/USDAParser.js';
import {USDLoader} from 'three/examples/jsm/loaders/USDLoader.js';

globalThis.ProgressEvent ??= class {};
const text = readFileSync(process.argv[2], 'utf8'), told = {meshes: [], instancers: []};
new USDLoader().parse(text).traverse(o => {
    if (o.isMesh) told.meshes.push({name: o.name, triangles: (o.geometry.index ?? o.geometry.attributes.position).count / 3});
});
// It composes no PointInstancer, but its parser reads them.
const specs = new USDAParser().parseData(text).specsByPath;
for (const [path, {fields}] of Object.entries(specs)) {
    if (fields.typeName !== 'PointInstancer') continue;
    const length = (name, width) => (specs[`${path}.${name}`]?.fields.default.length ?? 0) / width;
    const copies = {};
    const models = specs[`${path}.prototypes`].fields.targetPaths;
    for (const index of specs[`${path}.protoIndices`].fields.default) copies[index] = (copies[index] ?? 0) + 1;
    told.instancers.push({name: path.split('/').pop(), copies, models, ids: length('ids', 1), positions: length('positions', 3),
                          orientations: length('orientations', 4), scales: length('scales', 3)});
}
console.log(JSON.stringify(told));
