// What draws the blocks of every page: charts, pictures of bars and cells, tables, a picker of channels. One file of more
// than 400 lines, for its parts stand in one scope on a page and none is of use without the others.
document.documentElement.dataset.theme = matchMedia('(prefers-color-scheme: dark)').matches ? 'dark' : 'light';
const css = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const save = (name, type, text) => {
  const link = make('a'), url = URL.createObjectURL(new Blob([text], { type }));
  link.href = url; link.download = name; link.click();
  setTimeout(() => URL.revokeObjectURL(url), 1000);
};
const fileName = text => text.replace(/[^\w.-]+/g, '_').slice(0, 80) || 'picture';

const STYLES = { run: ['--c0'], reference: ['--c1'], third: ['--c2'], other: ['--other', 1.2], limit: ['--ink', 1.4, [6, 4]], points: ['--c1'], cloud: ['--c0'], band: ['--band'], repeat: ['--c1', 0.7] };
const LINES = [[], [7, 4], [2, 3], [9, 3, 2, 3]];
const colourOf = c => css(c.colour === undefined || c.colour === null ? (STYLES[c.style] || STYLES.run)[0] : c.style === 'limit' ? '--ink' : '--c' + c.colour % 8);
const widthOf = c => c.width || (STYLES[c.style] || [0, 1.6])[1] || 1.6;
const dashOf = c => c.dash !== undefined && c.dash !== null ? LINES[c.dash % 4] : (STYLES[c.style] || [])[2] || [];
const isDots = c => c.style === 'points' || c.style === 'cloud' || Boolean(c.points);
const radiusOf = c => c.points || (c.style === 'cloud' ? 1.3 : 3.5);
// what is found in the light theme, for pictures that are saved
const light = c => { const theme = document.documentElement.dataset.theme; document.documentElement.dataset.theme = 'light'; const found = c(); document.documentElement.dataset.theme = theme; return found; };
// about so many round values of a scale in decades, and what to write at them; low, high, values: their logarithms
function decades(low, high, count) {
  for (const of of [[1, 2, 5], [1, 3], [1]]) {
    const values = [];
    for (let e = Math.floor(low); e <= high; e++) for (const m of of) { const v = e + Math.log10(m); if (v >= low - 1e-9 && v <= high + 1e-9) values.push(v); }
    if (values.length < 2) break;
    const each = of.length > 1 ? 1 : Math.ceil(values.length / Math.max(count, 2)), kept = values.filter((_, k) => k % each === 0);
    if (kept.length <= Math.max(count, 2)) return { values: kept, texts: kept.map(v => short(+Math.pow(10, v).toPrecision(1))) };
  }
  const { values, texts } = ticks(Math.pow(10, low), Math.pow(10, high), count);  // less than a decade
  return { values: values.map(Math.log10), texts };
}
const charts = [];
const FONT = '11.5px system-ui, sans-serif';  // of numbers at scales
const pen = document.createElement('canvas').getContext('2d');
const widest = (texts, font) => { pen.font = font; return Math.max(...texts.map(t => pen.measureText(t).width), 0); };
const cut = (text, width) => { while (text.length > 3 && widest([text], FONT) > width) text = text.slice(0, -3).trimEnd() + '..'; return text; };
// a label that is no wider than its place, with its unit
const shortened = (text, width) => { const unit = (/ \[[^\]]*\]$/.exec(text) || [''])[0]; return cut(text.slice(0, text.length - unit.length), width - widest([unit], FONT)) + unit; };

class Chart {
  constructor(item, parent) {
    this.item = item;
    let x = null;  // curves over the same x have it once
    this.curves = item.curves.map(c => { x = floats(c.x, c.start) || x; return { ...c, x, y: floats(c.y, c.offset), high: floats(c.high, c.offset), shown: c.shown !== false }; });
    if (item.log) for (const c of this.curves) { c.x = Array.from(c.x, Math.log10); c.y = Array.from(c.y, Math.log10); }
    this.figure = make('figure', null, parent);
    const caption = make('figcaption', null, this.figure);
    make('b', item.title, caption);
    if (item.note) make('span', item.note, caption, 'soft');
    const tools = make('span', null, caption, 'tools'), tool = (text, title, act) => { const b = make('button', text, tools); b.title = title; b.onclick = act; };
    tool('+', 'closer', () => this.zoom(0.5)); tool('\u2212', 'farther', () => this.zoom(2)); tool('all', 'everything (double click)', () => show(this, null));
    tool('SVG', 'save as SVG', () => save(fileName(item.title) + '.svg', 'image/svg+xml', svgOf(this.picture())));
    tool('PDF', 'save as PDF', () => save(fileName(item.title) + '.pdf', 'application/pdf', pdfOf(this.picture())));
    const named = this.curves.filter(c => c.name);
    if (named.length > 1) {
      const keys = make('div', null, this.figure, 'keys');
      for (const c of named) {
        const label = make('label', null, keys), box = make('input', null, label), line = make('i', null, label);
        box.type = 'checkbox'; box.checked = c.shown;
        box.onchange = () => { for (const o of this.curves) if (o === c || (o.name === '' && o.group === c.group && c.style === o.style)) o.shown = box.checked; this.range(); this.redraw(); };
        c.line = line;
        make('span', c.name, label);
      }
    }
    this.plot = make('div', null, this.figure, 'plot');
    this.plot.setAttribute('role', 'img');
    this.plot.setAttribute('aria-label', item.title + ': ' + item.y + ' over ' + item.x);
    this.read = make('div', '', this.figure, 'read');
    this.x = null; this.mark = null;
    new IntersectionObserver((entries, o) => { if (entries.some(e => e.isIntersecting)) { o.disconnect(); this.build(); } }, { rootMargin: '300px' }).observe(this.plot);
    new ResizeObserver(() => { if (this.u && Math.abs(this.plot.clientWidth - this.u.width) > 1) this.build(); }).observe(this.plot);
  }
  height() { return this.item.equal ? Math.max(260, Math.min(0.7 * this.plot.clientWidth, 560)) : this.item.tall ? 330 : 250; }
  // limits of both axes: of x those asked for, or of all curves; of y those of what is seen
  range() {
    let [a, b] = this.x || [Infinity, -Infinity], low = Infinity, high = -Infinity;
    const shown = this.curves.filter(c => c.shown);
    if (!this.x) for (const c of shown) for (const v of c.x) if (isFinite(v)) { if (v < a) a = v; if (v > b) b = v; }
    if (!(a <= b)) [a, b] = [0, 1];
    if (b - a <= 1e-9 * Math.max(Math.abs(a), Math.abs(b), 1e-12)) { a -= 0.5; b += 0.5; }
    for (const c of shown) for (const of of [c.y, c.high]) if (of) for (let i = 0; i < of.length; i++) {
      const v = of[i];
      if (isFinite(v) && c.x[i] >= a && c.x[i] <= b) { if (v < low) low = v; if (v > high) high = v; }
    }
    if (this.item.zero) { low = Math.min(low, 0); high = Math.max(high, 0); }
    if (!(low <= high)) [low, high] = [-1, 1];
    // below this, the swing is the rounding of 32-bit floats, or that of a simulation where they have an offset
    const rounded = shown.some(c => c.offset) ? 1e-10 : 1e-6;
    if (high - low <= rounded * Math.max(Math.abs(low), Math.abs(high), 1e-12)) { const d = Math.max(0.01 * Math.abs(low), 1e-6); low -= d; high += d; }
    const pad = 0.06 * (high - low);
    this.box = [a, b, low - pad, high + pad];
    if (this.y) [this.box[2], this.box[3]] = this.y;
    if (!this.x && this.curves.some(isDots)) { this.box[0] -= 0.04 * (b - a); this.box[1] += 0.04 * (b - a); }
  }
  equalised(w, h) {
    const b = this.box.slice();
    if (!this.item.equal) return b;
    const sx = (b[1] - b[0]) / w, sy = (b[3] - b[2]) / h, s = Math.max(sx, sy);
    const grow = (k, size) => { const m = 0.5 * (b[k] + b[k + 1]); b[k] = m - 0.5 * s * size; b[k + 1] = m + 0.5 * s * size; };
    grow(0, w); grow(2, h);
    return b;
  }
  build() {
    if (!this.plot.clientWidth) return;
    if (this.u) this.u.destroy();
    this.range();
    const ink = css('--ink'), faint = css('--line'), W = this.plot.clientWidth, H = this.height();
    for (const c of this.curves) if (c.line) {
      c.line.style.borderTopColor = colourOf(c);
      c.line.style.borderTopStyle = dashOf(c).length ? (dashOf(c)[0] < 4 ? 'dotted' : 'dashed') : 'solid';
      if (c.style === 'band') c.line.style.borderTopWidth = '10px';
      if (isDots(c)) { c.line.className = 'dot'; c.line.style.borderWidth = Math.max(2 * radiusOf(c), 3) / 2 + 'px'; c.line.style.borderColor = colourOf(c); }
    }
    const limits = u => this.equalised(Math.max(u.bbox.width, 10) / devicePixelRatio, Math.max(u.bbox.height, 10) / devicePixelRatio);
    const scale = this.item.log ? decades : ticks, axis = (label, size) => ({ stroke: ink, grid: { stroke: faint, width: 1 }, ticks: { stroke: faint, width: 1 }, label, labelSize: 20, labelFont: '12px system-ui, sans-serif', font: FONT, size,
      splits: (u, i, low, high, step) => scale(low, high, (i ? u.bbox.height / 34 : u.bbox.width / 84) / devicePixelRatio).values,
      values: (u, at, i) => { const t = scale(i ? u.scales.y.min : u.scales.x.min, i ? u.scales.y.max : u.scales.x.max, (i ? u.bbox.height / 34 : u.bbox.width / 84) / devicePixelRatio); return t.texts; } });
    this.u = new uPlot({
      mode: 2, width: W, height: H, legend: { show: false }, padding: [8, 20, 0, 0],
      scales: { x: { time: false, auto: false, range: u => limits(u).slice(0, 2) }, y: { time: false, auto: false, range: u => limits(u).slice(2) } },
      axes: [axis(this.item.x, 34), axis(shortened(this.item.y, (H - 66) * 11.5 / 12), (u, texts) => Math.max(60, 18 + Math.ceil(widest(texts || [], FONT))))],  // 18: mark, gap, rest
      cursor: { points: { show: false }, dataIdx: () => null, drag: { x: true, y: true, uni: 24, setScale: false }, bind: { dblclick: () => () => show(this, null) } },
      series: [null, ...this.curves.map(c => ({ facets: [{ scale: 'x', auto: false }, { scale: 'y', auto: false }], points: { show: false }, show: true,
        stroke: () => colourOf(c), fill: () => colourOf(c), width: c.style === 'band' ? 0 : widthOf(c), dash: dashOf(c), paths: u => this.path(u, c) }))],
      hooks: {
        setCursor: [u => this.tell(u)],
        setSelect: [u => { const s = u.select; u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          if (s.width > 5 || s.height > 5) {
            if (s.height > 5 && s.height < u.over.clientHeight - 1) this.y = [u.posToVal(s.top + s.height, 'y'), u.posToVal(s.top, 'y')];
            show(this, s.width > 5 && s.width < u.over.clientWidth - 1 ? [u.posToVal(s.left, 'x'), u.posToVal(s.left + s.width, 'x')] : this.x);
          } else if (this.item.seeks) document.dispatchEvent(new CustomEvent('seek', { detail: u.posToVal(s.left, 'x') })); }],
        draw: [u => { if (this.mark === null) return; const g = u.ctx, x = Math.round(u.valToPos(this.mark, 'x', true)); g.save(); g.strokeStyle = css('--c0'); g.lineWidth = devicePixelRatio; g.beginPath(); g.moveTo(x, u.bbox.top); g.lineTo(x, u.bbox.top + u.bbox.height); g.stroke(); g.restore(); }],
      },
    }, [null, ...this.curves.map(c => [c.x, c.y])], this.plot);
    this.u.over.addEventListener('wheel', event => { if (!event.ctrlKey && !event.shiftKey) return; event.preventDefault();
      this.zoom(Math.exp(Math.sign(event.deltaY || event.deltaX) * 0.25), this.u.posToVal(event.offsetX, 'x')); }, { passive: false });
    this.redraw();
  }
  path(u, c) {
    const none = { stroke: null, fill: null, flags: 0 };
    if (!c.shown) return none;
    const { min: a, max: b } = u.scales.x, { min: lo, max: hi } = u.scales.y, m = u.bbox;
    const X = v => m.left + (v - a) / (b - a) * m.width, Y = v => m.top + m.height - (v - lo) / (hi - lo) * m.height, path = new Path2D();
    if (isDots(c)) {
      const r = radiusOf(c) * devicePixelRatio;
      for (let i = 0; i < c.x.length; i++) if (isFinite(c.y[i])) { path.moveTo(X(c.x[i]) + r, Y(c.y[i])); path.arc(X(c.x[i]), Y(c.y[i]), r, 0, 7); }
      return { stroke: null, fill: path, flags: 0 };
    }
    if (c.high) {
      for (let i = 0; i < c.x.length; i++) path.lineTo(X(c.x[i]), Y(c.high[i]));
      for (let i = c.x.length - 1; i >= 0; i--) path.lineTo(X(c.x[i]), Y(c.y[i]));
      return { stroke: null, fill: path, flags: 0 };
    }
    let pen = false;
    for (let i = 0; i < c.x.length; i++) {
      if (!isFinite(c.x[i]) || !isFinite(c.y[i])) { pen = false; continue; }
      if (pen) path.lineTo(X(c.x[i]), Y(c.y[i])); else path.moveTo(X(c.x[i]), Y(c.y[i]));
      pen = true;
    }
    return { stroke: path, fill: null, flags: 0 };
  }
  redraw() {
    if (!this.u) return;
    this.range();
    const u = this.u, b = this.equalised(u.bbox.width / devicePixelRatio, u.bbox.height / devicePixelRatio);
    u.batch(() => { u.setScale('x', { min: b[0], max: b[1] }); u.setScale('y', { min: b[2], max: b[3] }); });
    u.redraw(true, true);
  }
  zoom(factor, about) {
    if (!this.u) return;
    const { min, max } = this.u.scales.x, at = about === undefined ? 0.5 * (min + max) : about;
    if (this.item.equal) { const s = this.u.scales.y, m = 0.5 * (s.min + s.max); this.y = [m + (s.min - m) * factor, m + (s.max - m) * factor]; }
    show(this, [at + (min - at) * factor, at + (max - at) * factor]);
  }
  // the values at the pointer: of curves over a rising x those next to it, of others those of the nearest point
  tell(u) {
    if (u.cursor.left < 0) { this.read.textContent = ''; return; }
    const x = u.posToVal(u.cursor.left, 'x'), y = u.posToVal(u.cursor.top, 'y'), parts = [];
    const needed = (scale, least) => { const { min, max } = u.scales[scale]; return Math.max(least, Math.min(14, Math.ceil(3 + Math.log10(Math.max(Math.abs(min), Math.abs(max)) / (max - min))))); };
    const digits = needed('y', 5), origin = this.item.origin || 0;
    const labelled = this.curves.filter(c => c.shown && c.labels);
    if (labelled.length) {  // the point next to the pointer, with its label
      let best = Infinity, text = '';
      for (const c of labelled) c.labels.forEach((label, k) => { const d = Math.hypot(u.valToPos(c.x[k], 'x') - u.cursor.left, u.valToPos(c.y[k], 'y') - u.cursor.top); if (d < best) { best = d; text = label; } });
      this.read.textContent = text;
      return;
    }
    for (const c of this.curves) {
      if (!c.shown || c.high || !c.x.length || c.style === 'limit') continue;
      if (c.rising === undefined) c.rising = c.x.every((v, i) => !i || v >= c.x[i - 1]);
      let k = 0;
      if (c.rising) {
        let high = c.x.length - 1;
        while (k < high) { const m = (k + high) >> 1; if (c.x[m] < x) k = m + 1; else high = m; }
        if (k > 0 && x - c.x[k - 1] < c.x[k] - x) k--;
        parts.push((c.name ? c.name + ' ' : '') + short(c.y[k], digits));
      } else {
        let best = Infinity;
        const sx = u.scales.x.max - u.scales.x.min, sy = u.scales.y.max - u.scales.y.min;
        for (let i = 0; i < c.x.length; i++) { const d = ((c.x[i] - x) / sx) ** 2 + ((c.y[i] - y) / sy) ** 2; if (d < best) { best = d; k = i; } }
        parts.push((c.name ? c.name + ' ' : '') + '(' + short(c.x[k], 5) + ', ' + short(c.y[k], digits) + ')');
      }
    }
    this.read.textContent = this.item.x.replace(/ \[.*/, '') + ' ' + (origin ? (x + origin).toFixed(Math.max(0, Math.min(9, Math.ceil(3 - Math.log10(u.scales.x.max - u.scales.x.min))))) : short(x, needed('x', 7))) + '   ' + parts.slice(0, 8).join('   ');
  }
  // all that is seen, as lines and texts of a picture of 720 to 360 points
  picture() {
    const w = 720, legend = this.curves.filter(c => c.shown && c.name).length > 1, h = this.item.equal ? 540 : 360;
    this.range();
    const m = { left: 66, right: w - 14, top: 26 + (legend ? 18 : 0), bottom: h - 42 }, out = [];
    const seen = this.equalised(m.right - m.left, m.bottom - m.top), scale = this.item.log ? decades : ticks, numbers = scale(seen[2], seen[3], (m.bottom - m.top) / 34).texts;
    m.left = Math.max(66, 30 + Math.ceil(widest(numbers, '10px Helvetica, Arial, sans-serif')));
    const [a, b, lo, hi] = this.equalised(m.right - m.left, m.bottom - m.top), clip = { x: m.left, y: m.top, w: m.right - m.left, h: m.bottom - m.top };
    const X = v => m.left + (v - a) / (b - a) * clip.w, Y = v => m.bottom - (v - lo) / (hi - lo) * clip.h, x = scale(a, b, clip.w / 80), y = scale(lo, hi, clip.h / 34);
    for (const v of x.values) out.push({ line: [[X(v), m.top], [X(v), m.bottom]], colour: '#e4e6ea', width: 0.6 });
    for (const v of y.values) out.push({ line: [[m.left, Y(v)], [m.right, Y(v)]], colour: '#e4e6ea', width: 0.6 });
    for (const c of this.curves) {
      if (!c.shown) continue;
      const colour = c.style === 'band' ? '#cfe2f0' : light(() => colourOf(c));
      const runs = [[]];
      for (let i = 0; i < c.x.length; i++) if (isFinite(c.x[i]) && isFinite(c.y[i])) runs[runs.length - 1].push([X(c.x[i]), Y(c.y[i])]); else if (runs[runs.length - 1].length) runs.push([]);
      if (c.high) out.push({ area: [...Array.from(c.x, (v, i) => [X(v), Y(c.high[i])]), ...Array.from(c.x, (v, i) => [X(v), Y(c.y[i])]).reverse()], colour, clip });
      else if (isDots(c)) for (const [px, py] of runs.flat()) { if (px >= m.left - 1 && px <= m.right + 1 && py >= m.top - 1 && py <= m.bottom + 1) out.push({ dot: [px, py], colour, r: c.points || (c.style === 'cloud' ? 1.2 : 3) }); }
      else for (const line of runs) if (line.length > 1) out.push({ line, colour, width: widthOf(c), dash: dashOf(c), clip });
    }
    out.push({ line: [[m.left, m.top], [m.right, m.top], [m.right, m.bottom], [m.left, m.bottom], [m.left, m.top]], colour: '#7d8794', width: 0.8 });
    x.values.forEach((v, i) => out.push({ text: x.texts[i], at: [X(v), m.bottom + 14], anchor: 'middle', size: 10 }));
    y.values.forEach((v, i) => out.push({ text: y.texts[i], at: [m.left - 5, Y(v) + 3.5], anchor: 'end', size: 10 }));
    out.push({ text: this.item.x, at: [0.5 * (m.left + m.right), h - 10], anchor: 'middle', size: 11 });
    out.push({ text: this.item.y, at: [14, 0.5 * (m.top + m.bottom)], anchor: 'middle', size: 11, turned: true });
    out.push({ text: this.item.title, at: [m.left, 17], anchor: 'start', size: 12, bold: true });
    if (legend) {
      let at = m.left;
      for (const c of this.curves) if (c.shown && c.name && at < m.right - 60) {
        out.push({ line: [[at, 32], [at + 22, 32]], colour: light(() => colourOf(c)), width: 2, dash: dashOf(c) });
        out.push({ text: c.name, at: [at + 26, 35.5], anchor: 'start', size: 10 });
        at += 40 + 5.2 * c.name.length;
      }
    }
    return { w, h, parts: out };
  }
}

const escaped = text => text.replace(/[&<>"]/g, c => ({ '&': '&amp;', '<': '&lt;', '>': '&gt;', '"': '&quot;' })[c]);
const two = v => String(Math.round(100 * v) / 100);
function svgOf({ w, h, parts, paper = '#fff', ink = '#000' }) {
  const clips = [], lines = [], at = points => points.map(p => two(p[0]) + ',' + two(p[1])).join(' ');
  for (const p of parts) {
    let clip = '';
    if (p.clip) { if (!clips.length) clips.push(`<clipPath id="c"><rect x="${p.clip.x}" y="${p.clip.y}" width="${p.clip.w}" height="${p.clip.h}"/></clipPath>`); clip = ' clip-path="url(#c)"'; }
    if (p.line) lines.push(`<polyline points="${at(p.line)}" fill="none" stroke="${p.colour}" stroke-width="${p.width}"${p.dash && p.dash.length ? ` stroke-dasharray="${p.dash.join(' ')}"` : ''}${clip}/>`);
    else if (p.area) lines.push(`<polygon points="${at(p.area)}" fill="${p.colour}"${p.i === undefined ? '' : ` data-i="${p.i}"`}${clip}/>`);
    else if (p.dot) lines.push(`<circle cx="${two(p.dot[0])}" cy="${two(p.dot[1])}" r="${p.r}" fill="${p.colour}"/>`);
    else lines.push(`<text x="${two(p.at[0])}" y="${two(p.at[1])}" font-size="${p.size}" text-anchor="${p.anchor}"${p.colour ? ` fill="${p.colour}" pointer-events="none"` : ''}${p.bold ? ' font-weight="bold"' : ''}${p.turned ? ` transform="rotate(-90 ${two(p.at[0])} ${two(p.at[1])})"` : ''}>${escaped(p.text)}</text>`);
  }
  return `<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 ${w} ${h}" width="${w}" height="${h}" fill="${ink}" font-family="Helvetica, Arial, sans-serif"><defs>${clips.join('')}</defs><rect width="${w}" height="${h}" fill="${paper}"/>${lines.join('\n')}</svg>\n`;
}
// widths of Helvetica, in thousandths of its size: what texts are centred by
const WIDE = { ' ': 278, '.': 278, ',': 278, ':': 278, '-': 333, '(': 333, ')': 333, '[': 278, ']': 278, '/': 278, i: 222, l: 222, j: 222, t: 278, f: 278, r: 333, m: 833, w: 722, I: 278 };
function pdfOf({ w, h, parts }) {
  const paint = [], rgb = c => { const d = document.createElement('canvas').getContext('2d'); d.fillStyle = c; const s = d.fillStyle, v = k => two(parseInt(s.slice(k, k + 2), 16) / 255); return `${v(1)} ${v(3)} ${v(5)}`; };
  const y = v => two(h - v), path = points => points.map((p, i) => `${two(p[0])} ${y(p[1])} ${i ? 'l' : 'm'}`).join(' ');
  const text = t => '(' + Array.from(t, c => { const code = { '\u2212': 45, '\u00b1': 177, '\u00b0': 176, '\u00b7': 183, '\u00b2': 178, '\u00b3': 179 }[c] || c.charCodeAt(0); return code > 255 || code < 32 ? '?' : code > 126 || '()\\'.includes(c) ? '\\' + code.toString(8).padStart(3, '0') : c; }).join('') + ')';
  for (const p of parts) {
    paint.push('q');
    if (p.clip) paint.push(`${p.clip.x} ${two(h - p.clip.y - p.clip.h)} ${p.clip.w} ${p.clip.h} re W n`);
    if (p.line) paint.push(`${rgb(p.colour)} RG ${p.width} w [${(p.dash || []).join(' ')}] 0 d ${path(p.line)} S`);
    else if (p.area) paint.push(`${rgb(p.colour)} rg ${path(p.area)} f`);
    else if (p.dot) { const [cx, cy] = p.dot, k = 0.5523 * p.r, q = (a, b) => `${two(cx + a)} ${y(cy + b)}`;
      paint.push(`${rgb(p.colour)} rg ${q(p.r, 0)} m ${q(p.r, k)} ${q(k, p.r)} ${q(0, p.r)} c ${q(-k, p.r)} ${q(-p.r, k)} ${q(-p.r, 0)} c ${q(-p.r, -k)} ${q(-k, -p.r)} ${q(0, -p.r)} c ${q(k, -p.r)} ${q(p.r, -k)} ${q(p.r, 0)} c f`); }
    else {
      const width = p.size * Array.from(p.text).reduce((s, c) => s + (WIDE[c] || 556), 0) / 1000, back = p.anchor === 'middle' ? 0.5 * width : p.anchor === 'end' ? width : 0;
      const [tx, ty] = p.at, place = p.turned ? `0 1 -1 0 ${two(tx)} ${two(h - ty - back)}` : `1 0 0 1 ${two(tx - back)} ${y(ty)}`;
      paint.push(`BT ${p.colour ? rgb(p.colour) : '0.11 0.14 0.19'} rg /${p.bold ? 'B' : 'F'} ${p.size} Tf ${place} Tm ${text(p.text)} Tj ET`);
    }
    paint.push('Q');
  }
  const stream = paint.join('\n'), font = name => `<< /Type /Font /Subtype /Type1 /BaseFont /${name} /Encoding /WinAnsiEncoding >>`;
  const objects = ['<< /Type /Catalog /Pages 2 0 R >>', '<< /Type /Pages /Kids [3 0 R] /Count 1 >>',
    `<< /Type /Page /Parent 2 0 R /MediaBox [0 0 ${w} ${h}] /Contents 4 0 R /Resources << /Font << /F 5 0 R /B 6 0 R >> >> >>`,
    `<< /Length ${stream.length} >>\nstream\n${stream}\nendstream`, font('Helvetica'), font('Helvetica-Bold')];
  let out = '%PDF-1.4\n';
  const places = objects.map((o, i) => { const at = out.length; out += `${i + 1} 0 obj\n${o}\nendobj\n`; return at; }), begin = out.length;
  return out + `xref\n0 ${objects.length + 1}\n0000000000 65535 f \n${places.map(at => String(at).padStart(10, '0') + ' 00000 n \n').join('')}trailer\n<< /Size ${objects.length + 1} /Root 1 0 R >>\nstartxref\n${begin}\n%%EOF\n`;
}

// a picture of bars or cells as wide as its place; what lies under the pointer is said below. parts(w): of a picture
// of that width, in colours of the theme
function drawing(b, parent, parts, series = []) {
  const figure = make('figure', null, parent), caption = make('figcaption', null, figure), name = fileName(b.title);
  make('b', b.title, caption);
  if (b.note) make('span', b.note, caption, 'soft');
  const tools = make('span', null, caption, 'tools'), keys = make('div', null, figure, 'keys'), plot = make('div', null, figure, 'drawn'), read = make('div', '', figure, 'read');
  make('button', 'SVG', tools).onclick = () => save(name + '.svg', 'image/svg+xml', svgOf(light(() => parts(720))));
  make('button', 'PDF', tools).onclick = () => save(name + '.pdf', 'application/pdf', pdfOf(light(() => parts(720))));
  plot.setAttribute('role', 'img');
  plot.setAttribute('aria-label', b.title);
  const build = () => { plot.innerHTML = svgOf({ ...parts(Math.max(plot.clientWidth, 280)), paper: 'none', ink: css('--ink') }); for (const s of series) s.line.style.borderTopColor = css(s.colour); };
  for (const s of series) {
    const label = make('label', null, keys), box = make('input', null, label);
    s.line = make('i', null, label);
    s.line.style.borderTopWidth = '10px';
    box.type = 'checkbox'; box.checked = s.shown = true;
    box.onchange = () => { s.shown = box.checked; build(); };
    make('span', s.name, label);
  }
  plot.onpointermove = plot.onpointerdown = event => { const i = event.target.dataset.i; read.textContent = i === undefined ? '' : b.says[i]; };
  new ResizeObserver(build).observe(plot);
  document.addEventListener('theme', build);
  build();
}
const corners = (x, y, w, h) => [[x, y], [x + w, y], [x + w, y + h], [x, y + h]];
// bars of rows, a series behind the other; a limit is a line across
function bars(b, parent) {
  drawing(b, parent, w => {
    const n = b.names.length, row = n > 20 ? 16 : 26, left = Math.min(widest(b.names, FONT) + 12, 0.4 * w), right = w - 18, top = 4, bottom = top + n * row, out = [];
    const all = b.names.map((_, k) => b.series.reduce((sum, s) => sum + (s.shown ? s.values[k] || 0 : 0), 0));
    const most = 1.05 * Math.max(...all, b.limit || 0, 1e-12), X = v => left + v / most * (right - left), { values, texts } = ticks(0, most, (right - left) / 84);
    for (const v of values) out.push({ line: [[X(v), top], [X(v), bottom]], colour: css('--line'), width: 0.6 });
    b.names.forEach((name, k) => {
      let from = 0;
      b.series.forEach((s, i) => {
        if (!s.shown || !s.values[k]) return;
        out.push({ area: corners(X(from), top + (k + 0.14) * row, X(s.values[k]) - X(0), 0.72 * row), colour: css(s.colour), i: k * b.series.length + i });
        from += s.values[k];
      });
      out.push({ text: cut(name, left - 12), at: [left - 7, top + (k + 0.5) * row + 4], anchor: 'end', size: 11 });
    });
    out.push({ line: [[left, top], [left, bottom], [right, bottom]], colour: css('--other'), width: 0.8 });
    if (b.limit) out.push({ line: [[X(b.limit), top], [X(b.limit), bottom]], colour: css('--ink'), width: 1.4, dash: [6, 4] });
    values.forEach((v, i) => out.push({ text: texts[i], at: [X(v), bottom + 15], anchor: 'middle', size: 11 }));
    out.push({ text: b.x, at: [0.5 * (left + right), bottom + 33], anchor: 'middle', size: 11 });
    return { w, h: bottom + 40, parts: out };
  }, b.series);
}
// cells of rows and columns, the darker the larger on a scale in decades between two values; null: not known
function cells(b, parent) {
  const [low, high] = b.between.map(Math.log10), hex = c => [1, 3, 5].map(k => parseInt(c.slice(k, k + 2), 16));
  drawing(b, parent, w => {
    const left = Math.min(widest(b.rows, FONT) + 12, 0.4 * w), step = Math.min((w - left - 4) / b.columns.length, 90), row = 26, top = 4, bottom = top + b.rows.length * row, out = [];
    const paper = hex(css('--card')), full = hex(css('--c1')), bright = c => 0.299 * c[0] + 0.587 * c[1] + 0.114 * c[2] > 140;
    b.rows.forEach((name, k) => {
      out.push({ text: cut(name, left - 12), at: [left - 7, top + (k + 0.5) * row + 4], anchor: 'end', size: 11 });
      b.values[k].forEach((v, i) => {
        const part = v === null ? 0 : Math.max(0, Math.min(1, (Math.log10(Math.max(v, 1e-300)) - low) / (high - low))), colour = paper.map((p, j) => Math.round(p + part * (full[j] - p)));
        out.push({ area: corners(left + i * step + 0.5, top + k * row + 0.5, step - 1, row - 1), colour: '#' + colour.map(c => c.toString(16).padStart(2, '0')).join(''), i: k * b.columns.length + i });
        const text = v === null ? '-' : v < 1e-6 ? '0' : v < 10 ? short(+v.toPrecision(1)) : v.toFixed(0);
        if (widest([text], '10px Helvetica, Arial, sans-serif') < step - 2) out.push({ text, at: [left + (i + 0.5) * step, top + (k + 0.5) * row + 4], anchor: 'middle', size: 10, colour: bright(colour) ? '#111111' : '#ffffff' });
      });
    });
    b.columns.forEach((name, i) => out.push({ text: name, at: [left + (i + 0.5) * step + 4, bottom + 6], anchor: 'end', size: 11, turned: true }));
    return { w, h: bottom + 14 + Math.ceil(widest(b.columns, FONT)), parts: out };
  });
}

// bytes of a text in base64, inflated
const inflated = async text => new Response(new Blob([Uint8Array.from(atob(text), c => c.charCodeAt(0))]).stream().pipeThrough(new DecompressionStream('deflate'))).arrayBuffer();
// runs a program that the page holds deflated
async function started(name) { make('script', new TextDecoder().decode(await inflated(data.programs[name])), document.body); }

// zooms a chart, and with it those that are linked to it, in x
function show(chart, x) {
  for (const c of charts) if (c === chart || (chart.item.linked && c.item.linked === chart.item.linked)) {
    c.x = x; if (!x) c.y = null;
    if (c !== chart) c.y = null;
    c.redraw();
  }
}
function chart(item, parent) { const c = new Chart(item, parent); charts.push(c); return c; }

const BAD = /^(FAIL|FAILED|OUTSIDE|NOT MET|NO|error|suspect|NOT REACHED|SUSPECT)\b|\bFAIL$/, GOOD = /^(pass|ok|yes|met)$/;
function table(block, parent) {
  let filter = null;
  if (block.rows.length > 12) { filter = make('input', null, parent); filter.type = 'search'; filter.placeholder = 'show rows that contain ...'; filter.setAttribute('aria-label', 'filter rows'); }
  const t = make('table', null, make('div', null, parent, 'scroll')), head = make('tr', null, make('thead', null, t)), body = make('tbody', null, t), lines = [], named = block.columns.some(Boolean);
  const numeric = cell => typeof cell === 'number' || /^[-+]?\d[\d.]*(e[-+]?\d+)?( %| \u00b1 .*| FAIL)?$/.test(cell || '');
  const value = cell => cell === null || cell === '' || cell === '-' ? null : typeof cell === 'number' ? cell : /^[-+]?\d[\d.]*(e[-+]?\d+)?( |$)/.test(cell) ? parseFloat(cell) : String(cell);
  // numbers stand to the right in columns that are mostly numbers, and as texts do in others
  const filled = k => block.rows.map(row => row[k]).filter(cell => cell !== null && cell !== ''), right = block.columns.map((name, k) => named && 2 * filled(k).filter(numeric).length >= filled(k).length);
  block.rows.forEach((row, i) => {
    const tr = make('tr', null, body, (block.bad || []).includes(i) ? 'bad' : '');
    row.forEach((cell, k) => { const text = short(cell, 5); make('td', text, tr, (right[k] && numeric(cell) ? 'number ' : '') + (text.length > 24 ? 'long ' : '') + (!k ? '' : BAD.test(text) ? 'bad' : GOOD.test(text) ? 'ok' : '')); });
    const goes = (block.goes || [])[i];
    if (goes !== undefined && goes !== null) { tr.className += ' goes'; tr.onclick = () => charts.filter(c => c.item.key === goes).slice(0, 1).forEach(c => c.figure.scrollIntoView({ behavior: 'smooth', block: 'center' })); }
    lines.push([row, tr]);
  });
  if (named) block.columns.forEach((name, k) => {
    const th = make('th', name, head, right[k] ? 'right' : '');
    th.tabIndex = 0;
    const sort = () => {
      const up = th.getAttribute('aria-sort') === 'ascending';
      for (const other of head.children) other.removeAttribute('aria-sort');
      th.setAttribute('aria-sort', up ? 'descending' : 'ascending');
      const way = up ? -1 : 1;
      lines.slice().sort(([a], [b]) => {
        const p = value(a[k]), q = value(b[k]);
        if (p === null || q === null) return (p === null) - (q === null);
        return way * (typeof p === 'number' && typeof q === 'number' ? p - q : String(p).localeCompare(String(q)));
      }).forEach(([, tr]) => body.appendChild(tr));
    };
    th.onclick = sort;
    th.onkeydown = event => { if (event.key === 'Enter') sort(); };
  });
  if (filter) filter.oninput = () => lines.forEach(([row, tr]) => { tr.hidden = !row.join(' ').toLowerCase().includes(filter.value.toLowerCase()); });
}

// channels of one or more runs to pick from; each that is picked is a chart with all runs
function channels(block, parent) {
  const names = Object.keys(block.channels), shown = new Map(), bar = make('div', null, parent);
  const filter = make('input', null, bar), count = make('span', '', bar, 'soft');
  filter.type = 'search'; filter.placeholder = names.length + ' channels: imu, force ...'; filter.setAttribute('aria-label', 'filter channels');
  const picker = make('div', null, parent, 'picker'), grid = make('div', null, parent, 'charts'), boxes = [];
  const pick = (name, on) => {
    if (on && !shown.has(name)) {
      const c = block.channels[name];
      shown.set(name, chart({ title: name, x: 'time [s]', y: c.label, linked: 'time', origin: block.origin || 0,
        curves: c.runs.map((r, i) => r && { name: block.runs.length > 1 ? block.runs[i] : '', style: 'run', colour: block.runs.length > 1 ? i : 1, x: r[0], start: block.start, y: r[1], offset: r[2] }).filter(Boolean) }, grid));
    } else if (!on && shown.has(name)) {
      const c = shown.get(name);
      c.figure.remove(); charts.splice(charts.indexOf(c), 1); shown.delete(name);
    }
    count.textContent = '  ' + shown.size + ' shown';
  };
  for (const name of names) {
    const label = make('label', null, picker), box = make('input', null, label);
    box.type = 'checkbox'; box.checked = block.chosen.includes(name);
    box.onchange = () => pick(name, box.checked);
    make('span', ' ' + name, label);
    boxes.push([name, label]);
  }
  filter.oninput = () => boxes.forEach(([name, label]) => { label.hidden = !name.toLowerCase().includes(filter.value.toLowerCase()); label.style.display = label.hidden ? 'none' : ''; });
  block.chosen.forEach(name => pick(name, true));
}

// Markdown of a line: code, bold, links to pages; all else is text
function inline(text, parent) {
  for (const part of text.split(/(`[^`]+`|\*\*[^*]+\*\*|\[[^\]]+\]\([^)]+\))/)) {
    if (/^`.+`$/.test(part)) make('code', part.slice(1, -1), parent);
    else if (/^\*\*.+\*\*$/.test(part)) make('b', part.slice(2, -2), parent);
    else if (/^\[.+\]\(.+\)$/.test(part)) parent.append(part.slice(1, part.indexOf('](')));
    else if (part) parent.append(part);
  }
}
const kinds = {
  heading: (b, parent) => { make(b.level > 2 ? 'h3' : 'h2', b.text, parent).id = b.id || ''; },
  text: (b, parent) => { for (const line of b.lines) inline(line, make('p', null, parent, b.soft ? 'soft' : '')); },
  table, channels, bars, cells,
  charts: (b, parent) => { const grid = make('div', null, parent, 'charts' + (b.wide ? ' wide' : '')); for (const item of b.charts) chart(item, grid); },
  picture: (b, parent) => {
    const figure = make('figure', null, parent), caption = make('figcaption', null, figure), tools = make('span', null, caption, 'tools');
    caption.prepend(b.caption);
    make('button', 'SVG', tools).onclick = () => save(fileName(b.name) + '.svg', 'image/svg+xml', b.svg);
    make('button', 'PDF', tools).onclick = () => { const raw = atob(b.pdf), bytes = Uint8Array.from(raw, c => c.charCodeAt(0)); save(fileName(b.name) + '.pdf', 'application/pdf', bytes); };
    const image = make('img', null, make('div', null, figure, 'picture'));
    image.alt = b.caption; image.style.maxWidth = '100%';
    image.src = 'data:image/svg+xml;base64,' + btoa(unescape(encodeURIComponent(b.svg)));
  },
  part: (b, parent) => {
    const part = make('details', null, parent);
    make('summary', b.title, part);
    let drawn = false;
    part.ontoggle = () => { if (part.open && !drawn) { drawn = true; draw(b.blocks, part); } };
    part.open = b.open;
  },
};
function draw(blocks, parent) { for (const block of blocks) kinds[block.kind](block, parent); }

function theme(name) {
  document.documentElement.dataset.theme = name;
  for (const c of charts) if (c.u) c.build();
  document.dispatchEvent(new CustomEvent('theme'));
}
function begin() {
  const page = document.getElementById('page'), dark = matchMedia('(prefers-color-scheme: dark)');
  dark.addEventListener('change', () => theme(dark.matches ? 'dark' : 'light'));
  const header = make('header', null, page);
  make('h1', data.title, header);
  const toggle = make('button', 'light / dark', header, 'small');
  toggle.onclick = () => theme(document.documentElement.dataset.theme === 'dark' ? 'light' : 'dark');
  if (data.verdict) make('p', data.verdict.text, page, 'verdict ' + (data.verdict.ok === true ? 'ok' : data.verdict.ok === false ? 'bad' : ''));
  for (const line of data.about) make('p', line, page);
  const details = make('details', null, page), of = name => [...new Set(data.facts.filter(f => f[0] === name).map(f => f[1]))];
  make('summary', ['What this page is of', ...of('vehicle'), ...of('program')].join('  \u00b7  '), details, 'small');
  details.open = data.facts.length <= 12 && innerWidth > 640;
  const facts = make('dl', null, details, 'facts');
  for (const [name, text] of data.facts) { make('dt', name, facts); make('dd', text, facts); }
  const headings = data.blocks.filter(b => b.kind === 'heading' && b.level === 2);
  headings.forEach((b, i) => { b.id = 's' + i; });
  if (headings.length > 3) { const nav = make('nav', null, page); for (const b of headings) { const a = make('a', b.text, nav); a.href = '#' + b.id; } }
  draw(data.blocks, page);
}
window.page = { data, charts, svgOf, pdfOf, show };  // for those who look behind the pictures
