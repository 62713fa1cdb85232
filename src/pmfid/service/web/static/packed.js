// Arrays as the service sends them, "f8:base64": their bytes, little endian, exact to the bit.
const KINDS = { f8: Float64Array, f4: Float32Array, i4: Int32Array, u4: Uint32Array, u1: Uint8Array };

export function unpacked(text) {
  const raw = atob(text.slice(3));
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return new KINDS[text.slice(0, 2)](bytes.buffer);
}
