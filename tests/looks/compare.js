// Reduces pictures to cells and compares them; runs on an empty page.

/** Pixels of a cell, each way. */
const CELL = 8;
/** Two colours are the same up to this, of 255: below what a step between two surfaces is. */
const SAME = 6;
/** And up to this share of the contrast around them: where letters stand, a heavier stroke changes the mean. */
const REACH = 0.5;

async function pixels(blob) {
  const bitmap = await createImageBitmap(blob, { colorSpaceConversion: "none" });
  const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
  const draw = canvas.getContext("2d");
  draw.drawImage(bitmap, 0, 0);
  return draw.getImageData(0, 0, bitmap.width, bitmap.height);
}

const bytesOf = (base64) => Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
const png = (bytes) => new Blob([bytes], { type: "image/png" });

/** The mean colour of each cell. */
async function cells(shot) {
  const { data, width, height } = await pixels(png(bytesOf(shot)));
  const [columns, rows] = [Math.ceil(width / CELL), Math.ceil(height / CELL)];
  const small = new ImageData(columns, rows);
  for (let row = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++) {
      const sums = [0, 0, 0];
      let count = 0;
      for (let y = row * CELL; y < Math.min(height, (row + 1) * CELL); y++) {
        for (let x = column * CELL; x < Math.min(width, (column + 1) * CELL); x++, count++) {
          for (let part = 0; part < 3; part++) sums[part] += data[4 * (y * width + x) + part];
        }
      }
      small.data.set([...sums.map((sum) => Math.round(sum / count)), 255], 4 * (row * columns + column));
    }
  }
  return small;
}

/** A picture as it is kept: PNG in base64. */
async function reduced(shot) {
  const small = await cells(shot);
  const canvas = new OffscreenCanvas(small.width, small.height);
  canvas.getContext("2d").putImageData(small, 0, 0);
  const bytes = new Uint8Array(await (await canvas.convertToBlob({ type: "image/png" })).arrayBuffer());
  return btoa(String.fromCharCode(...bytes));
}

/** How many cells of one picture have a colour that none of the cells around the same place of the other has, nor any between them. */
function strange(one, other) {
  let count = 0;
  for (let y = 0; y < one.height; y++) {
    for (let x = 0; x < one.width; x++) {
      const isStrange = [0, 1, 2].some((part) => {
        let [least, most] = [255, 0];
        for (let v = Math.max(0, y - 1); v <= Math.min(one.height - 1, y + 1); v++) {
          for (let u = Math.max(0, x - 1); u <= Math.min(one.width - 1, x + 1); u++) {
            const value = other.data[4 * (v * one.width + u) + part];
            least = Math.min(least, value);
            most = Math.max(most, value);
          }
        }
        const value = one.data[4 * (y * one.width + x) + part];
        const same = SAME + REACH * (most - least);
        return value < least - same || value > most + same;
      });
      if (isStrange) count++;
    }
  }
  return count;
}

/** The share of cells in which a picture differs from a kept one, whose bytes are in hexadecimal; 1: all, or of another size. */
async function differs(shot, keptHex) {
  if (keptHex === "") return 1;
  const now = await cells(shot);
  const kept = await pixels(png(Uint8Array.from(keptHex.match(/../g), (byte) => parseInt(byte, 16))));
  if (now.width !== kept.width || now.height !== kept.height) return 1;
  // Each is looked for in the other: what has vanished, and what has come.
  return (strange(now, kept) + strange(kept, now)) / (now.width * now.height);
}
