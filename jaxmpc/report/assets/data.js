// The data that the page carries: deflated text and columns, decoded once.

async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

const KINDS = { u8: Uint8Array, u16: Uint16Array, u32: Uint32Array, f64: Float64Array };

async function readArray(blob, start, said) {
  const planes = await inflate(blob.subarray(start + said.at, start + said.at + said.bytes));
  const width = KINDS[said.type].BYTES_PER_ELEMENT, size = said.size;
  if (width === 1) return planes;
  const bytes = new Uint8Array(size * width);
  for (let plane = 0; plane < width; plane++) {
    for (let i = 0, from = plane * size; i < size; i++) bytes[i * width + plane] = planes[from + i];
  }
  return new KINDS[said.type](bytes.buffer);
}

// Values of a measure, one array per tissue.
async function readMeasure(blob, start, said, count) {
  let flat;
  if (said.values) {
    flat = await readArray(blob, start, said.values);
  } else if (said.points) {
    const points = await readArray(blob, start, said.points), index = await readArray(blob, start, said.index);
    flat = Float64Array.from(index, (place) => points[place]);
  } else {
    const codes = await readArray(blob, start, said.codes), { low, high, log, levels } = said.scale;
    const values = new Float32Array(65536);
    for (let code = 0; code < levels; code++) {
      const at = low + ((high - low) * code) / (levels - 1);
      values[code] = log ? Math.exp(at) : at;
    }
    values[levels] = -Infinity;
    values[levels + 1] = Infinity;
    values[levels + 2] = NaN;
    flat = new Float32Array(codes.length);
    for (let i = 0; i < codes.length; i++) flat[i] = values[codes[i]];
  }
  const found = [];
  for (let t = 0; t * count < flat.length; t++) found.push(flat.subarray(t * count, (t + 1) * count));
  return found;
}

function worstOf(columns, floor) {
  if (columns.length === 1) return columns[0];
  const worst = Float64Array.from(columns[0]);
  for (const column of columns.slice(1)) {
    for (let i = 0; i < worst.length; i++) {
      const value = column[i];
      // NaN once is NaN for good.
      if (value !== value || (floor ? value < worst[i] : value > worst[i])) worst[i] = value;
    }
  }
  return worst;
}

async function readData() {
  const text = document.getElementById("data").textContent;
  const blob = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const length = new DataView(blob.buffer).getUint32(0, true);
  const said = JSON.parse(new TextDecoder().decode(await inflate(blob.subarray(4, 4 + length))));
  const rows = said.rows;
  if (!rows) return said;
  const start = 4 + length;
  rows.status = await readArray(blob, start, rows.status);
  await Promise.all(rows.measures.map(async (each) => {
    each.columns = await readMeasure(blob, start, each, rows.count);
    each.worst = worstOf(each.columns, each.sense === "floor");
  }));
  if (rows.names.steps) {
    let number = 0;
    rows.names = rows.names.steps.map((step) => `${rows.names.word} ${(number += step)}`);
  }
  return said;
}
