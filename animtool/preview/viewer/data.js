/** Streams of samples: blocks are decoded when they are first needed, the last few are kept. */

/** @typedef {import('./types.js').Stream} Stream */
/** @typedef {import('./types.js').Manifest} Manifest */
/** @typedef {Float32Array|Uint32Array|Uint16Array|Uint8Array} Values */
/** @typedef {Map<number, Values>} Block Values by stream, all of one sample after another. */

const BYTES = { u8: 1, i16: 2, u16: 2, u32: 4, f32: 4 };
/** Decoded blocks that are kept [bytes], and those that a frame needs beside. */
const KEPT = 32e6;

/** @param {string} text Base64. @returns {Promise<Uint8Array>} What it holds, inflated. */
async function inflate(text) {
  const raw = atob(text.trim());
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate-raw'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** What stands for NaN in streams with gaps. */
const GAP = -32768;

/**
 * Return the values of one stream of a block, sample by sample.
 *
 * Bytes stand column by column, and in a column plane by plane, the low bytes first. One
 * sample is one column.
 *
 * @param {Uint8Array} bytes @param {number} at Where the stream begins.
 * @param {Stream} stream @param {number} samples @returns {Values}
 */
function unpack(bytes, at, { kind, width, coding, scale, offset, gaps }, samples) {
  const size = BYTES[kind], total = width * samples;
  const columns = samples === 1 ? 1 : width, rows = samples === 1 ? width : samples;
  const plain = new Uint8Array(total * size);
  for (let c = 0, from = at; c < columns; c++) {
    for (let plane = 0; plane < size; plane++) {
      for (let i = 0, to = c * size + plane; i < rows; i++, to += columns * size) plain[to] = bytes[from++];
    }
  }
  const { buffer } = plain;
  const whole = kind === 'u8' ? plain : new ({
    i16: Int16Array, u16: Uint16Array, u32: Uint32Array, f32: Float32Array }[kind])(buffer);
  if (coding === 'delta') for (let i = columns; i < total; i++) whole[i] += whole[i - columns];
  if (scale === 1 && offset === 0 && !(whole instanceof Int16Array)) return whole;
  const out = new Float32Array(total), scales = [scale].flat(), offsets = [offset].flat();
  for (let i = 0, c = 0; i < total; i++, c = c + 1 === width ? 0 : c + 1) {
    out[i] = gaps && whole[i] === GAP ? NaN
      : offsets[c % offsets.length] + scales[c % scales.length] * whole[i];
  }
  return out;
}

/** @param {Block} block @returns {number} Its size [bytes]. */
const sizeOf = (block) => [...block.values()].reduce((sum, { byteLength }) => sum + byteLength, 0);

export class Streams {
  /** @param {Manifest} manifest @param {(block: number) => string} text Base64 of a block. */
  constructor(manifest, text) {
    this.text = text;
    /** @type {Map<number, Stream>} */
    this.byId = new Map(manifest.streams.map((each) => [each.id, each]));
    /** @type {Map<number, {stream: Stream, samples: number}[]>} */
    this.contents = new Map();
    for (const stream of [...manifest.streams].sort((a, b) => a.id - b.id)) {
      for (const [block, , samples] of stream.block) {
        const list = this.contents.get(block) ?? [];
        list.push({ stream, samples });
        this.contents.set(block, list);
      }
    }
    /** @type {Map<number, Block>} In order of their last use. */
    this.blocks = new Map();
    /** @type {Map<number, Promise<Block>>} */
    this.pending = new Map();
    /** @type {Map<number, Values>} */
    this.constant = new Map();
    /** @type {Map<number, number>} Streams that frames draw, and the frame of their first sample. */
    this.drawn = new Map();
    /** Most bytes of decoded blocks. */
    this.most = KEPT;
    /** Size of decoded blocks [bytes], and most blocks that a frame needs. */
    this.size = this.needed = 0;
  }

  /** Draw streams in every frame. @param {(number|null|undefined)[]} ids @param {number} [first] */
  use(ids, first = 0) {
    for (const id of ids) if (id != null && this.byId.has(id)) this.drawn.set(id, first);
  }

  /** @param {number} id */
  width(id) { return this.byId.get(id)?.width ?? 0; }

  /** @param {number} id @returns {number} How many samples a stream has. */
  count(id) {
    const last = this.byId.get(id)?.block.at(-1);
    return last ? last[1] + last[2] : 0;
  }

  /** @param {number} block @returns {Promise<Block>} */
  async decode(block) {
    const known = this.blocks.get(block);
    if (known) {
      this.blocks.delete(block);
      this.blocks.set(block, known);
      return known;
    }
    let wait = this.pending.get(block);
    if (!wait) {
      wait = this.#decode(block).finally(() => this.pending.delete(block));
      this.pending.set(block, wait);
    }
    return wait;
  }

  /** @param {number} block @returns {Promise<Block>} */
  async #decode(block) {
    const bytes = await inflate(this.text(block));
    /** @type {Block} */
    const values = new Map();
    let at = 0;
    for (const { stream, samples } of this.contents.get(block) ?? []) {
      const part = unpack(bytes, at, stream, samples);
      at += stream.width * samples * BYTES[stream.kind];
      if (this.count(stream.id) === 1) this.constant.set(stream.id, part);
      else values.set(stream.id, part);
    }
    this.blocks.set(block, values);
    this.size += sizeOf(values);
    for (const [oldest, held] of this.blocks) {
      if (this.size <= this.most || this.blocks.size <= 2 * this.needed) break;
      this.blocks.delete(oldest);
      this.size -= sizeOf(held);
    }
    return values;
  }

  /** @param {number} id @param {number} sample @returns {number[]|undefined} Its block's entry. */
  #entry(id, sample) {
    const spans = this.byId.get(id)?.block ?? [];
    return spans.find(([, first, n]) => sample < first + n) ?? spans.at(-1);
  }

  /** @param {number} sample @returns {number[]} Blocks that drawing it needs and that are not decoded. */
  missing(sample) {
    /** @type {Set<number>} */
    const needed = new Set();
    for (const [id, first] of this.drawn) {
      const entry = this.#entry(id, sample - first);
      if (entry && !this.constant.has(id)) needed.add(entry[0]);
    }
    this.needed = Math.max(this.needed, needed.size);
    return [...needed].filter((block) => !this.blocks.has(block));
  }

  /** Decode what drawing a sample needs. @param {number} sample */
  async load(sample) {
    await Promise.all(this.missing(sample).map((block) => this.decode(block)));
  }

  /**
   * @param {number} id @param {number} sample
   * @returns {Values|null} Values of a frame, null while their block is not decoded.
   */
  at(id, sample) {
    const constant = this.constant.get(id);
    if (constant) return constant;
    sample -= this.drawn.get(id) ?? 0;
    const entry = this.#entry(id, sample);
    const values = entry && this.blocks.get(entry[0])?.get(id);
    if (!entry || !values) return null;
    const width = this.width(id);
    const i = Math.min(Math.max(sample - entry[1], 0), entry[2] - 1);
    return values.subarray(i * width, (i + 1) * width);
  }

  /** @param {number} id @returns {Promise<Values>} The values of a stream of one sample. */
  async whole(id) {
    for (const [block] of this.byId.get(id)?.block ?? []) {
      const known = this.constant.get(id) ?? (await this.decode(block)).get(id);
      return known ?? this.constant.get(id) ?? new Float32Array(0);
    }
    return new Float32Array(0);
  }

  /** @param {number} id @param {number} column @returns {Promise<Float32Array>} One value of all samples. */
  async column(id, column) {
    const width = this.width(id), out = new Float32Array(this.count(id));
    for (const [block, first, samples] of this.byId.get(id)?.block ?? []) {
      const values = this.constant.get(id) ?? (await this.decode(block)).get(id) ?? this.constant.get(id);
      for (let i = 0; values && i < samples; i++) out[first + i] = values[i * width + column];
    }
    return out;
  }
}
