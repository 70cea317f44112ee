// What all pages share: their data, elements, numbers, round values of scales, a canvas as fine as the screen.
'use strict';
const data = JSON.parse(document.getElementById('data').textContent);
const make = (tag, text, parent, cls) => {
  const e = document.createElement(tag);
  if (text !== undefined && text !== null) e.textContent = text;
  if (cls) e.className = cls;
  if (parent) parent.appendChild(e);
  return e;
};
// offset: what is added to each, in all digits
const floats = (text, offset) => {
  if (text === null || text === undefined) return null;
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  const values = new Float32Array(bytes.buffer);
  return offset ? Float64Array.from(values, v => offset + v) : values;
};
const short = (v, n = 4) => v === null || v === undefined ? '' : typeof v === 'string' ? v :
  v === 0 ? '0' : Math.abs(v) >= 1e5 || Math.abs(v) < 1e-3 ? v.toExponential(Math.max(n - 2, 1)) : String(+v.toPrecision(n));
// about so many round values from low to high, two at least, for one alone is no scale; and what to write at them
function ticks(low, high, count) {
  const raw = (high - low) / Math.max(count, 1), power = Math.pow(10, Math.floor(Math.log10(raw)));
  const step = [1, 2, 5, 10].map(m => m * power).find(s => s >= raw) || 10 * power, values = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) values.push(k * step);
  if (values.length < 2 && count < 20 && high > low) return ticks(low, high, 2 * Math.max(count, 1));
  const most = Math.max(...values.map(Math.abs), 0), fine = Math.floor(Math.log10(step) + 1e-9);
  if (most >= 1e5 || (most > 0 && most < 1e-3)) {
    const order = Math.floor(Math.log10(most)), digits = Math.max(0, Math.min(12, order - fine));
    return { values, texts: values.map(v => v === 0 ? '0' : (v / Math.pow(10, order)).toFixed(digits) + 'e' + order) };
  }
  return { values, texts: values.map(v => v.toFixed(Math.max(0, Math.min(12, -fine)))) };
}

// a canvas as fine as the screen, empty: [context, width, height]
function cleared(canvas) {
  const ratio = window.devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) { canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio); }
  const g = canvas.getContext('2d');
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, w, h);
  g.font = '12px system-ui, "DejaVu Sans", sans-serif';
  return [g, w, h];
}
