// What the page carries: blocks of base64 in <script> elements, deflated and with the bytes of numbers sorted by
// significance, which frames and tables name by number.

const decoded = new Map();  // of the frames in use

export const meta = JSON.parse(document.getElementById('sekitei').textContent);

function bytesOf(text) {
    if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
    const binary = atob(text), bytes = new Uint8Array(binary.length);
    for (let i = 0; i < bytes.length; ++i) bytes[i] = binary.charCodeAt(i);
    return bytes;
}

async function inflate(bytes, size) {
    const reader = new Response(bytes).body.pipeThrough(new DecompressionStream('deflate')).getReader();
    const whole = new Uint8Array(size);
    let at = 0;
    for (;;) {
        const {done, value} = await reader.read();
        if (done) break;
        if (at + value.length > size) throw new Error('the page is damaged: a block is longer than it says');
        whole.set(value, at);
        at += value.length;
    }
    if (at !== size) throw new Error(`the page is damaged: a block of ${size} bytes has ${at}`);
    return whole;
}

// Bytes 0, 1, .. of all numbers one after the other become numbers again.
function together(planes, width) {
    const count = planes.length / width, whole = new Uint8Array(planes.length);
    if (width === 4) {
        const words = new Uint32Array(whole.buffer);
        for (let i = 0; i < count; ++i)
            words[i] = planes[i] | planes[count + i] << 8 | planes[2 * count + i] << 16 | planes[3 * count + i] << 24;
        return whole;
    }
    for (let b = 0; b < width; ++b)
        for (let i = 0, from = b * count, to = b; i < count; ++i, ++from, to += width) whole[to] = planes[from];
    return whole;
}

async function decode(id) {
    const element = document.getElementById('b' + id);
    if (!element) throw new Error(`the page is damaged: block ${id} of ${meta.blocks.length} is missing; was it saved whole?`);
    const {size, width, packed} = meta.blocks[id];
    let bytes = bytesOf(element.textContent);
    if (packed) bytes = await inflate(bytes, size);
    if (bytes.length !== size) throw new Error(`the page is damaged: block ${id} has ${bytes.length} bytes, not ${size}`);
    return width > 1 ? together(bytes, width) : bytes;
}

/// The bytes of a block; the same array for all who ask.
export function block(id) {
    if (!decoded.has(id)) decoded.set(id, decode(id));
    return decoded.get(id);
}

/// Forgets all blocks but these.
export function keepOnly(ids) {
    for (const id of decoded.keys()) if (!ids.has(id)) decoded.delete(id);
}

/// A frame's .glb, put together again.
export async function glbOf(frame) {
    const json = await block(frame.glb.json), parts = await Promise.all(frame.glb.views.map(view => block(view.block)));
    let body = 0;
    for (const view of frame.glb.views) body = Math.max(body, view.offset + meta.blocks[view.block].size);
    const pad = n => (n + 3) & ~3, head = pad(json.length), tail = pad(body);
    const bytes = new Uint8Array(12 + 8 + head + 8 + tail), words = new DataView(bytes.buffer);
    words.setUint32(0, 0x46546C67, true);
    words.setUint32(4, 2, true);
    words.setUint32(8, bytes.length, true);
    words.setUint32(12, head, true);
    words.setUint32(16, 0x4E4F534A, true);
    bytes.fill(32, 20, 20 + head);
    bytes.set(json, 20);
    words.setUint32(20 + head, tail, true);
    words.setUint32(24 + head, 0x004E4942, true);
    frame.glb.views.forEach((view, i) => bytes.set(parts[i], 28 + head + view.offset));
    return bytes.buffer;
}
