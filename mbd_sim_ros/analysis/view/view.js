// Recordings in motion: the picture of scene.js, a slider of time; charts with `seeks` show the instant, and a click in one goes there.

// (n, m) numbers from whole ones of 16 bits: columns one after the other, second differences, high bytes before low ones, deflated
async function unpacked({ rows, columns, offset, scale, data }) {
  const bytes = new Uint8Array(await inflated(data)), count = rows * columns, whole = new Int16Array(count), out = new Float32Array(count), o = floats(offset), s = floats(scale);
  for (let i = 0; i < count; i++) whole[i] = (bytes[i] << 8) | bytes[count + i];
  for (let c = 0; c < columns; c++) {
    const col = whole.subarray(c * rows, (c + 1) * rows);
    for (let pass = 0; pass < 2; pass++) for (let k = 1; k < rows; k++) col[k] += col[k - 1];
    for (let k = 0; k < rows; k++) out[k * columns + c] = col[k] === -32768 ? NaN : o[c] + s[c] * col[k];
  }
  return out;
}

const METRES = 10, nodes = new Map(), view = { at, drawn };  // view: for those who look behind the picture
kinds.motion = (block, parent) => {
  const home = make('div', null, parent, 'motion'), legend = make('p', null, home, 'soft legend'), canvas = make('canvas', null, home);
  make('p', 'drag: turn, shift and drag: move, wheel: zoom, space: play, arrows: one picture', home, 'soft');
  const bar = make('div', null, home, 'bar'), play = make('button', 'Play', bar), speed = make('select', null, bar), slider = make('input', null, bar), clock = make('span', '', bar, 'clock');
  for (const [text, value] of [['0.1 x', 0.1], ['0.25 x', 0.25], ['1 x', 1], ['2 x', 2]]) { const o = make('option', text, speed); o.value = value; o.selected = value === 1; }
  speed.setAttribute('aria-label', 'speed'); slider.type = 'range'; slider.step = 'any'; slider.setAttribute('aria-label', 'time');
  canvas.setAttribute('role', 'img'); canvas.setAttribute('aria-label', 'the motion in three dimensions');
  for (const key of ['origin', 'size', 'ground', 'runs']) data[key] = view[key] = block[key];  // where scene.js looks
  view.ground = (x0, y0) => grid(x0, y0, METRES, nodes);
  const set = async run => {
    run.time = floats(run.time, run.start); run.base = floats(run.base);
    const n = run.time.length, m = run.bodies * 7, w = 3 * run.wheels.length, all = await unpacked(run.packed), width = m + 2 * w;
    run.pose = new Float32Array(n * m); run.contact = new Float32Array(n * w); run.force = new Float32Array(n * w);
    for (let k = 0; k < n; k++) {
      for (let i = 0; i < m; i++) run.pose[k * m + i] = all[k * width + i] + (i % 7 < 3 ? run.base[3 * k + i % 7] : 0);
      for (let i = 0; i < w; i++) { run.contact[k * w + i] = all[k * width + m + i] + run.base[3 * k + i % 3]; run.force[k * w + i] = all[k * width + m + w + i]; }
    }
  };
  view.ready = Promise.all([started('THREE'), ...block.runs.map(set)]).then(() => {
    if (block.ground) { const [x, y, z] = ['x', 'y', 'z'].map(key => floats(block.ground[key])); x.forEach((v, i) => nodes.set(`${v},${y[i]}`, z[i])); }
    const runs = block.runs, start = Math.min(...runs.map(r => r.time[0])), end = Math.max(...runs.map(r => r.time[r.time.length - 1]));
    const camera = { azimuth: -2.2, elevation: 0.35, half: block.size, shift: [0, 0], fov: 0 };
    let now = start, playing = false, last = 0;
    const flat = () => {  // a mechanism whose bodies stay in the plane z = const is looked at from above
      let low = Infinity, high = -Infinity;
      for (let i = 2; i < runs[0].pose.length; i += 7) { low = Math.min(low, runs[0].pose[i]); high = Math.max(high, runs[0].pose[i]); }
      return high - low < 1e-3 * block.size;
    };
    if (runs[0].follows < 0) { camera.azimuth = -Math.PI / 2; camera.elevation = flat() ? Math.PI / 2 : 0.35; }
    slider.min = start; slider.max = end;
    const picture = view.picture = new Picture(canvas, block.size);
    const paint = () => {
      const first = runs[0], states = runs.map((run, r) => [run, at(run, now), r > 0]), pose = states[0][1].pose;
      const target = first.follows < 0 ? block.origin.map(x => -x) : Array.from(pose.slice(7 * first.follows, 7 * first.follows + 3));
      if (first.follows >= 0) target[2] += 0.5;
      // a metre grid on the ground around the car, standing in the world
      const lines = first.follows < 0 ? [] : view.ground(Math.round(target[0] + block.origin[0]), Math.round(target[1] + block.origin[1])).map(points => [COLOURS.ground, points]);
      picture.draw(states, lines, target, camera);
    };
    const go = t => {
      now = Math.min(end, Math.max(start, t)); slider.value = now; clock.textContent = `t = ${now.toFixed(3)} s`; paint();
      for (const c of charts) if (c.item.seeks) { c.mark = now - (c.item.origin || 0); if (c.u) c.u.redraw(false, false); }
    };
    const tick = time => { if (!playing) return; const t = now + speed.value * (time - last) / 1000; last = time; go(t); if (t >= end) toggle(); else requestAnimationFrame(tick); };
    const toggle = () => { playing = !playing; play.textContent = playing ? 'Pause' : 'Play'; if (playing) { if (now >= end) now = start; last = performance.now(); requestAnimationFrame(tick); } };
    play.onclick = toggle;
    slider.oninput = () => go(+slider.value);
    document.addEventListener('seek', event => go(event.detail));
    document.addEventListener('theme', () => { coloured(); paint(); });
    document.addEventListener('keydown', event => {
      if (event.target !== document.body) return;
      if (event.key === ' ') { event.preventDefault(); toggle(); } if (event.key === 'ArrowRight') go(now + 0.02); if (event.key === 'ArrowLeft') go(now - 0.02);
    });
    handled(canvas, camera, paint);
    new ResizeObserver(paint).observe(canvas);
    const lines = runs[0].lines;
    for (const [kind, label, there] of [
      ['body', 'links', lines.some(line => line[7] === 'body')], ['spring', 'springs and dampers', runs[0].springs.length],
      ['wheel', 'wheels', runs[0].wheels.length], ['force', `forces on the tires, 1 m for ${NEWTONS_PER_METRE / 1000} kN`, runs[0].wheels.length],
      ['ghost', runs.length > 1 ? `ghost: ${runs.slice(1).map(r => r.name).join(', ')}` : '', runs.length > 1]]) if (there) {
      const mark = make('b', '\u2501', legend);
      const paintMark = () => { mark.style.color = COLOURS[kind] || GHOST; };
      paintMark(); document.addEventListener('theme', paintMark);
      legend.append(label);
    }
    view.go = go;
    const asked = Number(new URLSearchParams(location.search).get('t'));
    go(asked ? asked : start);
  });
};
