// The words of `sekitei explain` for any place. Every number was computed and rounded by the program; nothing is
// worked out here but which place is nearest.

import {block} from './data.js';

/// m * 10^e as printf's %.{digits}g shows it.
export function general(m, e, digits) {
    if (e === 127) return 'nan';
    if (m === 0) return '0';
    const sign = m < 0 ? '-' : '';
    let s = String(Math.abs(m)).replace(/0+$/, '');
    const exponent = String(Math.abs(m)).length - 1 + e;
    if (exponent < -4 || exponent >= digits) {
        const power = String(Math.abs(exponent)).padStart(2, '0');
        return sign + s[0] + (s.length > 1 ? '.' + s.slice(1) : '') + 'e' + (exponent < 0 ? '-' : '+') + power;
    }
    if (exponent < 0) return sign + '0.' + '0'.repeat(-exponent - 1) + s;
    s = s.padEnd(exponent + 1, '0');
    return sign + s.slice(0, exponent + 1) + (s.length > exponent + 1 ? '.' + s.slice(exponent + 1) : '');
}

const array = async (Type, id) => { const b = await block(id); return new Type(b.buffer, b.byteOffset, b.byteLength / Type.BYTES_PER_ELEMENT); };

/// A column of numbers as text.
async function column(c, count) {
    if (c.digits) {
        const m = await array(Int16Array, c.mantissa), e = await array(Int8Array, c.exponent);
        return i => general(m[i], e[i], c.digits);
    }
    const v = await array(Int16Array, c.fixed);
    return i => v[i] === -32768 ? 'nan' : (v[i] / 10 ** c.places).toFixed(c.places);
}

/// Everything `table` (of a frame) says of the places of its scene.
export async function explainer(table) {
    const count = table.count, position = await array(Float64Array, table.position);
    const columns = list => Promise.all(list.map(c => column(c, count)));
    const at = await columns(table.at), normal = await columns(table.normal), [area] = await columns([table.area]);
    const measures = await columns(table.measures.map(m => m.column)), wind = await columns(table.wind);
    const species = await Promise.all(table.species.map(async s => ({
        name: s.name, numbers: await columns(s.numbers), mean: s.mean && (await column(s.mean, count)), flags: await block(s.flags)})));
    let growing;
    if (table.growing) {
        const g = table.growing;
        growing = {begin: await array(Uint32Array, g.begin), who: await array(Uint16Array, g.who),
                   growth: await column(g.growth), days: await array(Int32Array, g.days)};
    }
    return {
        /// The place nearest to a point (z up), as C++ finds it: the first of several.
        nearest(p) {
            let best = 0, least = Infinity;
            for (let i = 0; i < count; ++i) {
                const x = position[3 * i] - p[0], y = position[3 * i + 1] - p[1], z = position[3 * i + 2] - p[2];
                const d = x * x + y * y + z * z;
                if (d < least) least = d, best = i;
            }
            return {place: best, away: Math.sqrt(least)};
        },
        position: i => [position[3 * i], position[3 * i + 1], position[3 * i + 2]],
        tell(i) {
            return {
                name: table.of_mesh ? `face ${i}` : 'cell',
                at: at.map(f => f(i)), normal: normal.map(f => f(i)), area: area(i),
                measures: table.measures.map((m, k) => ({...m, text: measures[k](i)})),
                wind: wind.map((f, k) => ({from: table.winds[k], text: f(i)})),
                species: species.map(s => ({
                    name: s.name, factors: s.numbers.slice(0, 4).map(f => f(i)), G: s.numbers[4](i), mean: s.mean && s.mean(i),
                    limiting: table.factors[s.flags[i] & 3], limits: s.flags[i] & 3, grows: !!(s.flags[i] & 4)})),
                growing: growing && Array.from({length: growing.begin[i + 1] - growing.begin[i]}, (_, k) => {
                    const j = growing.begin[i] + k;
                    return {name: table.names[growing.who[j]], growth: growing.growth(j), days: growing.days[j]};
                }),
            };
        },
    };
}
