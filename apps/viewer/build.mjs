// Bundles src/ and three.js into one file that the program carries: node build.mjs [OUTPUT].
import {build} from 'esbuild';

const outfile = process.argv[2] ?? new URL('../../data/viewer/viewer.js', import.meta.url).pathname;
await build({
    entryPoints: [new URL('src/viewer.js', import.meta.url).pathname],
    outfile, bundle: true, minify: true, format: 'iife', target: 'es2020', charset: 'ascii', legalComments: 'none',
    banner: {js: '/* Sekitei viewer, Apache-2.0; with three.js, MIT, Copyright 2010-2026 three.js authors. */'},
    logLevel: 'warning',
});
