// node usda.mjs FILE.usda: what three.js's parser finds in it, as JSON.
import {readFileSync} from 'node:fs';
import {USDLoader} from 'three/examples/jsm/loaders/USDLoader.js';

globalThis.ProgressEvent ??= class {};
const scene = new USDLoader().parse(readFileSync(process.argv[2], 'utf8'));
const told = {meshes: [], copies: [], up: [], triangles: 0};
scene.traverse(o => {
    if (o.isInstancedMesh) told.copies.push({name: o.name, count: o.count});
    else if (o.isMesh) {
        const g = o.geometry, n = (g.index ?? g.attributes.position).count / 3;
        told.meshes.push({name: o.name, triangles: n, vertices: g.attributes.position.count});
        told.triangles += n;
    }
});
console.log(JSON.stringify(told));
