// The picture of a model in motion: what is drawn, and how. The pages of a recording (view.js) and of a car that is driven (drive.html)
// share it. `data` gives the drawing (data.runs), half the height of what is seen (data.size) and the origin of all places (data.origin).
const LIGHT = { outline: '#8a8a8a', body: '#0072b2', wheel: '#222222', spring: '#e69f00', force: '#d55e00', ground: '#dddddd', world: '#bbbbbb' };
const DARK = { body: '#56b4e9', wheel: '#b5b5b5', ground: '#3d4148' }, COLOURS = {};
const coloured = () => Object.assign(COLOURS, LIGHT, /^rgb\((\d|[1-9]\d), /.test(getComputedStyle(document.body).backgroundColor) ? DARK : {});
coloured();
const GHOST = '#cc79a7', NEWTONS_PER_METRE = 6000;

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => { const n = Math.hypot(...a); return a.map(x => x / n); };

// vectors turned by unit quaternions
const turned = (q, o, x, y, z) => {
  const tx = 2 * (q[o + 1] * z - q[o + 2] * y), ty = 2 * (q[o + 2] * x - q[o] * z), tz = 2 * (q[o] * y - q[o + 1] * x), w = q[o + 3];
  return [x + w * tx + q[o + 1] * tz - q[o + 2] * ty, y + w * ty + q[o + 2] * tx - q[o] * tz, z + w * tz + q[o] * ty - q[o + 1] * tx];
};

// the poses of a run at an instant, between the two that were recorded next to it
function at(run, t) {
  const n = run.time.length; let lo = 0, hi = n - 1;
  while (hi - lo > 1) { const mid = (lo + hi) >> 1; if (run.time[mid] <= t) lo = mid; else hi = mid; }
  const span = run.time[hi] - run.time[lo], part = span > 0 ? Math.min(1, Math.max(0, (t - run.time[lo]) / span)) : 0;
  const m = run.bodies * 7, pose = new Float64Array(m);
  for (let b = 0; b < m; b += 7) {
    const a = lo * m + b, c = hi * m + b;
    for (let i = 0; i < 3; i++) pose[b + i] = run.pose[a + i] + part * (run.pose[c + i] - run.pose[a + i]);
    let dot = 0; for (let i = 3; i < 7; i++) dot += run.pose[a + i] * run.pose[c + i];
    const sign = dot < 0 ? -1 : 1; let norm = 0;
    for (let i = 3; i < 7; i++) { pose[b + i] = run.pose[a + i] + part * (sign * run.pose[c + i] - run.pose[a + i]); norm += pose[b + i] ** 2; }
    norm = Math.sqrt(norm); for (let i = 3; i < 7; i++) pose[b + i] /= norm;
  }
  const k = run.wheels.length * 3, mix = values => Array.from({ length: k }, (_, i) => values[lo * k + i] + part * (values[hi * k + i] - values[lo * k + i]));
  return { pose, contact: mix(run.contact), force: mix(run.force) };
}
const place = (pose, body, x, y, z) => {
  if (body < 0) return [x - data.origin[0], y - data.origin[1], z - data.origin[2]];
  const p = turned(pose, 7 * body + 3, x, y, z); return [p[0] + pose[7 * body], p[1] + pose[7 * body + 1], p[2] + pose[7 * body + 2]];
};

// everything that is drawn of a run at an instant: [colour, width, points in the world, whether it is an arrow]
function drawn(run, state, ghost) {
  const out = [], colour = kind => ghost ? GHOST : COLOURS[kind];
  for (const [body, ax, ay, az, bx, by, bz, kind] of run.lines)
    out.push([body < 0 ? COLOURS.world : colour(kind), kind === 'outline' ? 1.2 : 3, [place(state.pose, body, ax, ay, az), place(state.pose, body, bx, by, bz)]]);
  for (const [i, ax, ay, az, j, bx, by, bz] of run.springs) out.push([colour('spring'), 4, [place(state.pose, i, ax, ay, az), place(state.pose, j, bx, by, bz)]]);
  for (const wheel of run.wheels) {
    const [body, cx, cy, cz, nx, ny, nz, radius, width] = wheel;
    // two directions in the plane of the wheel, fixed on it: its spokes show that it turns
    const u = Math.abs(nz) < 0.9 ? unit(cross([nx, ny, nz], [0, 0, 1])) : unit(cross([nx, ny, nz], [1, 0, 0])), v = cross([nx, ny, nz], u);
    const rim = (r, s, k, of) => { const a = 2 * Math.PI * k / of, c = r * Math.cos(a), d = r * Math.sin(a);
      return place(state.pose, body, cx + c * u[0] + d * v[0] + s * nx, cy + c * u[1] + d * v[1] + s * ny, cz + c * u[2] + d * v[2] + s * nz); };
    for (const s of [-width / 2, width / 2]) out.push([colour('wheel'), 2, Array.from({ length: 29 }, (_, k) => rim(radius, s, k, 28))]);
    for (let k = 0; k < 5; k++) out.push([colour('wheel'), 1.2, [place(state.pose, body, cx, cy, cz), rim(radius, 0, k, 5)]]);
  }
  for (let w = 0; w < run.wheels.length; w++) {
    const p = state.contact.slice(3 * w, 3 * w + 3), f = state.force.slice(3 * w, 3 * w + 3).map(x => x / NEWTONS_PER_METRE);
    if (!Number.isFinite(p[0] + f[0])) continue;
    out.push([colour('force'), 3, [p, [p[0] + f[0], p[1] + f[1], p[2] + f[2]]], true]);
  }
  return out;
}
// the treads of the wheels: [colour, radius, the two middles of their sides]
const treads = (run, state, ghost) => run.wheels.map(([body, cx, cy, cz, nx, ny, nz, radius, width]) =>
  [ghost ? GHOST : COLOURS.wheel, radius, [-0.5, 0.5].map(s => place(state.pose, body, cx + s * width * nx, cy + s * width * ny, cz + s * width * nz))]);

// lines of the grid of metres that lies on the road around whole metres x0, y0 of the world; nodes: heights of places that are not on the base plane
function grid(x0, y0, reach, nodes, apart = 1) {
  const [h, hx, hy] = data.ground.plane, lines = [], steps = Array.from({ length: 2 * reach + 1 }, (_, i) => apart * (i - reach));
  const node = (x, y) => { const z = nodes.get(`${x},${y}`); return [x - data.origin[0], y - data.origin[1], z === undefined ? h + hx * x + hy * y - data.origin[2] : z]; };
  for (const i of steps) { lines.push(steps.map(j => node(x0 + i, y0 + j))); lines.push(steps.map(j => node(x0 + j, y0 + i))); }
  return lines;
}

const THICK = 0.0022;  // radius of a line of width 1, in half heights of the picture: a link of the full car is 17 mm thick
const HEAD = [3, 11];  // radius and length of an arrow's head, in radii of its shaft
const FAR = 4000;  // half heights of the picture that a camera with perspective sees ahead

// Draws lines as tubes with three.js; where the browser has no WebGL, or only one that the processor computes, as flat lines.
// In the address `?webgl` asks for tubes and `?flat` for lines all the same.
// camera: azimuth and elevation [rad] of the eye, half the height that is seen at the target [m], shift [pixels], and field of view [deg], 0 for none.
class Picture {
  constructor(canvas, size) {
    Object.assign(this, { canvas, size });
    const asked = new URLSearchParams(location.search), probe = asked.has('flat') ? null : document.createElement('canvas').getContext('webgl2');
    if (!probe) return;
    const by = probe.getParameter(probe.getExtension('WEBGL_debug_renderer_info')?.UNMASKED_RENDERER_WEBGL ?? probe.RENDERER);
    probe.getExtension('WEBGL_lose_context')?.loseContext();
    if (/swiftshader|llvmpipe|softpipe|software|basic render/i.test(by) && !asked.has('webgl')) return;
    try { this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true }); } catch { return; }
    this.scene = new THREE.Scene();
    const sun = new THREE.DirectionalLight(0xffffff, 1.3);
    sun.position.set(-0.5, 0.8, 2);
    this.scene.add(sun, new THREE.HemisphereLight(0xffffff, 0xaaaaaa, 2.9));
    const mesh = (shape, opacity) => this._mesh(shape, opacity);
    this.tubes = mesh(new THREE.CylinderGeometry(1, 1, 1, 8), 1);
    this.heads = mesh(new THREE.CylinderGeometry(0, 1, 1, 12), 1);
    this.ghosts = mesh(new THREE.CylinderGeometry(1, 1, 1, 6), 0.4);
    this.treads = mesh(new THREE.CylinderGeometry(1, 1, 1, 36), 0.25);
    this.flat = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ vertexColors: true }));
    this.flat.frustumCulled = false;
    this.scene.add(this.flat);
    this.cameras = [new THREE.OrthographicCamera(-1, 1, 1, -1, -FAR, FAR), new THREE.PerspectiveCamera(40, 1, 0.02 * size, FAR * size)];
  }
  _mesh(shape, opacity) {
    const many = new THREE.InstancedMesh(shape, new THREE.MeshLambertMaterial({ transparent: opacity < 1, opacity, depthWrite: opacity === 1 }), 0);
    many.frustumCulled = false;
    this.scene.add(many);
    return many;
  }
  // cylinders from a to b, [colour, radius, a, b] each
  _fill(mesh, parts, target) {
    if (mesh.instanceMatrix.count < parts.length) {
      const room = 2 * parts.length;
      mesh.dispose();
      mesh.instanceMatrix = new THREE.InstancedBufferAttribute(new Float32Array(16 * room), 16);
      mesh.instanceColor = new THREE.InstancedBufferAttribute(new Float32Array(3 * room), 3);
    }
    const m = mesh.instanceMatrix.array, c = mesh.instanceColor?.array;
    parts.forEach(([colour, radius, a, b], k) => {
      const x = b[0] - a[0], y = b[1] - a[1], z = b[2] - a[2], n = Math.hypot(x, y, z) || 1e-12, o = 16 * k;
      const u = unit(Math.abs(z) < 0.9 * n ? [y, -x, 0] : [0, z, -y]), v = cross(u, [x / n, y / n, z / n]);
      m[o] = radius * u[0]; m[o + 1] = radius * u[1]; m[o + 2] = radius * u[2]; m[o + 3] = 0;
      m[o + 4] = x; m[o + 5] = y; m[o + 6] = z; m[o + 7] = 0;
      m[o + 8] = radius * v[0]; m[o + 9] = radius * v[1]; m[o + 10] = radius * v[2]; m[o + 11] = 0;
      m[o + 12] = 0.5 * (a[0] + b[0]) - target[0]; m[o + 13] = 0.5 * (a[1] + b[1]) - target[1]; m[o + 14] = 0.5 * (a[2] + b[2]) - target[2]; m[o + 15] = 1;
      c.set(this._colour(colour), 3 * k);
    });
    mesh.count = parts.length;
    if (parts.length) mesh.instanceMatrix.needsUpdate = mesh.instanceColor.needsUpdate = true;
  }
  _colour(text) {
    this.known ??= new Map();
    if (!this.known.has(text)) this.known.set(text, new THREE.Color(text).toArray());
    return this.known.get(text);
  }
  // runs: [run, state, whether it is a ghost] each; lines: thin ones on the ground, [colour, points] each
  draw(runs, lines, target, camera) {
    if (!this.renderer) return this._drawFlat(runs, lines, target, camera);
    const width = this.canvas.clientWidth, height = this.canvas.clientHeight, parts = { tubes: [], heads: [], ghosts: [], treads: [] };
    if (!width || !height) return;
    for (const [run, state, ghost] of runs) {
      for (const [colour, thick, points, arrow] of drawn(run, state, ghost)) {
        const radius = thick * THICK * this.size, into = ghost ? parts.ghosts : parts.tubes;
        for (let i = 1; i < points.length; i++) {
          let a = points[i - 1], b = points[i];
          if (arrow && !ghost) {
            const n = Math.hypot(b[0] - a[0], b[1] - a[1], b[2] - a[2]), part = Math.min(1, HEAD[1] * radius / n), neck = b.map((x, j) => x - part * (x - a[j]));
            parts.heads.push([colour, HEAD[0] * radius, neck, b]); b = neck;
          }
          into.push([colour, radius, a, b]);
        }
      }
      for (const [colour, radius, [a, b]] of treads(run, state, ghost)) parts.treads.push([colour, radius, a, b]);
    }
    for (const name in parts) this._fill(this[name], parts[name], target);
    this._ground(lines, target);
    const { eye, up } = this._look(camera), one = this.cameras[camera.fov ? 1 : 0], half = camera.half;
    const away = camera.fov ? half / Math.tan(camera.fov * Math.PI / 360) : 0.5 * FAR * this.size;
    if (camera.fov) { one.fov = camera.fov; one.aspect = width / height; }
    else { const k = half / Math.min(width, height); Object.assign(one, { left: -k * width, right: k * width, top: k * height, bottom: -k * height, near: 0, far: FAR * this.size }); }
    one.setViewOffset(width, height, -camera.shift[0], -camera.shift[1], width, height);
    one.position.set(...eye.map(x => x * away)); one.up.set(...up); one.lookAt(0, 0, 0); one.updateProjectionMatrix();
    this.renderer.setPixelRatio(window.devicePixelRatio || 1);
    const now = this.renderer.getSize({ set(x, y) { this.x = x; this.y = y; return this; } });
    if (now.x !== width || now.y !== height) this.renderer.setSize(width, height, false);
    this.renderer.render(this.scene, one);
  }
  _look({ azimuth, elevation }) {
    const ca = Math.cos(azimuth), sa = Math.sin(azimuth), ce = Math.cos(elevation), se = Math.sin(elevation);
    return { eye: [ca * ce, sa * ce, se], right: [-sa, ca, 0], up: [-ca * se, -sa * se, ce] };
  }
  // the same array as before is the same ground: it only moves with the target
  _ground(lines, target) {
    this.flat.position.set(...this.from ? this.from.map((x, i) => x - target[i]) : [0, 0, 0]);
    if (this.lines === lines) return;
    this.lines = lines; this.from = target; this.flat.position.set(0, 0, 0);
    const count = lines.reduce((n, [, points]) => n + 2 * (points.length - 1), 0), shape = this.flat.geometry;
    if ((shape.attributes.position?.count ?? 0) < count) { shape.dispose(); for (const name of ['position', 'color']) shape.setAttribute(name, new THREE.BufferAttribute(new Float32Array(6 * count), 3)); }
    shape.setDrawRange(0, count);
    if (!count) return;
    const p = shape.attributes.position.array, c = shape.attributes.color.array; let o = 0;
    for (const [colour, points] of lines) for (let i = 1; i < points.length; i++) for (const point of [points[i - 1], points[i]]) {
      p[o] = point[0] - target[0]; p[o + 1] = point[1] - target[1]; p[o + 2] = point[2] - target[2]; c.set(this._colour(colour), o); o += 3;
    }
    shape.attributes.position.needsUpdate = shape.attributes.color.needsUpdate = true;
  }
  _drawFlat(runs, lines, target, camera) {
    const [g, width, height] = cleared(this.canvas), { eye, right, up } = this._look(camera), wide = camera.fov ? height : Math.min(height, width);
    const scale = wide / (2 * camera.half), away = camera.fov ? camera.half / Math.tan(camera.fov * Math.PI / 360) : Infinity, near = 0.02 * this.size;
    const seen = p => { const x = p[0] - target[0], y = p[1] - target[1], z = p[2] - target[2];  // to the right, upwards, and before the eye
      return [x * right[0] + y * right[1], x * up[0] + y * up[1] + z * up[2], away - (x * eye[0] + y * eye[1] + z * eye[2])]; };
    const to = ([x, y, depth]) => { const k = away < Infinity ? scale * away / depth : scale; return [width / 2 + camera.shift[0] + k * x, height / 2 + camera.shift[1] - k * y]; };
    const path = (points, colour, thick, arrow) => {
      g.strokeStyle = colour; g.lineWidth = thick; g.beginPath();
      let last = null, pen = false; const ends = [];
      for (const point of points) {
        let now = seen(point);
        if (now[2] > near) {
          if (last && last[2] <= near) { g.moveTo(...to(crossing(last, now))); pen = true; }
          const xy = to(now); if (pen) g.lineTo(...xy); else g.moveTo(...xy); pen = true; ends.push(xy);
        } else { if (pen) g.lineTo(...to(crossing(last, now))); pen = false; }
        last = now;
      }
      if (arrow && ends.length === 2) { const [[x0, y0], [x1, y1]] = ends, a = Math.atan2(y1 - y0, x1 - x0);
        if (Math.hypot(x1 - x0, y1 - y0) > 6) for (const s of [2.6, -2.6]) { g.moveTo(x1, y1); g.lineTo(x1 + 9 * Math.cos(a + s), y1 + 9 * Math.sin(a + s)); } }
      g.stroke();
      if (thick === 3 && !arrow) { g.fillStyle = colour; for (const [x, y] of ends) { g.beginPath(); g.arc(x, y, 3.5, 0, 7); g.fill(); } } };
    const crossing = (a, b) => { const k = (near - a[2]) / (b[2] - a[2]); return a.map((x, i) => x + k * (b[i] - x)); };
    g.lineCap = g.lineJoin = 'round';
    for (const [colour, points] of lines) path(points, colour, 1);
    for (const [run, state, ghost] of [...runs].reverse()) {
      g.globalAlpha = ghost ? 0.45 : 1;
      for (const [colour, thick, points, arrow] of drawn(run, state, ghost)) path(points, colour, thick, arrow);
    }
    g.globalAlpha = 1;
  }
}

// the hand on a picture: drag turns, shift and drag moves, the wheel zooms
function handled(canvas, camera, redraw) {
  canvas.addEventListener('pointerdown', event => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener('pointermove', event => { if (!event.buttons) return;
    if (event.shiftKey || event.buttons === 4) { camera.shift[0] += event.movementX; camera.shift[1] += event.movementY; }
    else { camera.azimuth -= 0.008 * event.movementX; camera.elevation = Math.min(Math.PI / 2, Math.max(-Math.PI / 2, camera.elevation + 0.008 * event.movementY)); }
    redraw(); });
  canvas.addEventListener('wheel', event => { event.preventDefault(); camera.half *= Math.exp(0.001 * event.deltaY); redraw(); }, { passive: false });
}
