// The map on a canvas: pan, zoom, walls with their uncertainty, anchors, track, truth.

import { add, across, ellipse, line, norm, scale, seen } from "./geometry.js";

const MARGIN = 0.12;

export class MapView {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.centre = [0, 0];
    this.zoom = 10; // pixels per metre
    this.scene = null;
    this.touched = false; // whether the user has moved the map
    this.pointers = new Map();
    new ResizeObserver(() => this.resize()).observe(canvas);
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
    }
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.closer(Math.exp(-event.deltaY * 0.0015), [event.offsetX, event.offsetY]);
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.type(event));
    canvas.addEventListener("pointerleave", () => this.onHover?.(null));
    canvas.addEventListener("click", (event) => {
      if (!this.dragged) this.onPick?.(this.under([event.offsetX, event.offsetY]));
    });
  }

  show(scene) {
    this.scene = scene;
    if (!this.touched) this.fit();
    else this.draw();
  }

  resize() {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth, clientHeight } = this.canvas;
    this.canvas.width = Math.round(clientWidth * ratio);
    this.canvas.height = Math.round(clientHeight * ratio);
    if (!this.touched) this.fit();
    else this.draw();
  }

  press(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.dragged = false;
    this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) {
      this.onHover?.(this.under([event.offsetX, event.offsetY]));
      return;
    }
    if (Math.hypot(event.offsetX - before[0], event.offsetY - before[1]) > 2) this.dragged = true;
    const now = [event.offsetX, event.offsetY];
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    this.pointers.set(event.pointerId, now);
    if (other) {
      const spread = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
      this.closer(spread(now) / Math.max(spread(before), 1), other);
    } else this.pan(now[0] - before[0], now[1] - before[1]);
  }

  type(event) {
    const step = 60;
    const moves = { ArrowLeft: [step, 0], ArrowRight: [-step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
    if (moves[event.key]) this.pan(...moves[event.key]);
    else if (event.key === "+" || event.key === "=") this.closer(1.25);
    else if (event.key === "-") this.closer(0.8);
    else if (event.key === "0") this.fitAgain();
    else return;
    event.preventDefault();
  }

  pan(dx, dy) {
    this.touched = true;
    this.centre = [this.centre[0] - dx / this.zoom, this.centre[1] + dy / this.zoom];
    this.draw();
  }

  closer(factor, at = [this.canvas.clientWidth / 2, this.canvas.clientHeight / 2]) {
    this.touched = true;
    const fixed = this.toMetres(at);
    this.zoom = Math.min(Math.max(this.zoom * factor, 0.05), 5000);
    const moved = this.toMetres(at);
    this.centre = add(this.centre, [fixed[0] - moved[0], fixed[1] - moved[1]]);
    this.draw();
  }

  fitAgain() {
    this.touched = false;
    this.fit();
  }

  fit() {
    const points = this.scene ? this.extent() : [];
    if (points.length) {
      const xs = points.map((p) => p[0]), ys = points.map((p) => p[1]);
      const low = [Math.min(...xs), Math.min(...ys)], high = [Math.max(...xs), Math.max(...ys)];
      const width = Math.max(high[0] - low[0], 2) * (1 + 2 * MARGIN), height = Math.max(high[1] - low[1], 2) * (1 + 2 * MARGIN);
      this.centre = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
      this.zoom = Math.min(this.canvas.clientWidth / width, this.canvas.clientHeight / height) || 10;
    }
    this.draw();
  }

  extent() {
    const { state, track, truth, place, other } = this.scene;
    const points = this.sampled(track).map(place);
    for (const anchor of state?.anchors ?? []) if (anchor.located) points.push(place(anchor.position_m));
    for (const wall of this.walls()) points.push(...wall.ends);
    for (const wall of truth?.walls ?? []) points.push(wall.from_m, wall.to_m);
    if (other) points.push(...this.sampled(other.walked).map(other.place));
    return points;
  }

  sampled(track, most = 400) {
    const every = Math.max(1, Math.ceil(track.length / most)), kept = [];
    for (let i = 0; i < track.length - 1; i += every) kept.push(track[i]);
    if (track.length) kept.push(track[track.length - 1]);
    return kept;
  }

  // Walls with their ends, found once for a scene.
  walls() {
    this.scene.walls ??= this.placedWalls();
    return this.scene.walls;
  }

  placedWalls() {
    const { state, track, place } = this.scene;
    if (!state) return [];
    const anchors = state.anchors.filter((anchor) => anchor.located).map((anchor) => anchor.position_m);
    const walked = this.sampled(track);
    return state.walls.map((wall) => {
      const { foot, tangent, normal } = line(wall.vrp_m);
      const [low, high] = seen(wall.vrp_m, anchors, walked);
      const at = (t, off = 0) => place(add(add(foot, scale(tangent, t)), scale(normal, off)));
      return { ...wall, low, high, at, ends: [at(low), at(high)] };
    });
  }

  // What lies under a pixel: an anchor, the nearest epoch of the track, a wall, or nothing; and where that is.
  under(pixel) {
    const found = { at: this.toMetres(pixel) };
    if (!this.scene?.state) return found;
    const { state, track, place } = this.scene, off = (p) => Math.hypot(p[0] - pixel[0], p[1] - pixel[1]);
    for (const anchor of state.anchors) {
      if (anchor.located && off(this.toPixels(place(anchor.position_m))) < 12) return { ...found, anchor };
    }
    let nearest = 8;
    for (let i = 0; i < track.length; i++) {
      const distance = off(this.toPixels(place(track[i])));
      if (distance < nearest) [nearest, found.epoch] = [distance, i];
    }
    if (found.epoch !== undefined) return found;
    for (const wall of this.seenWalls ?? []) {
      const [a, b] = wall.ends.map((p) => this.toPixels(p)), d = [b[0] - a[0], b[1] - a[1]];
      const t = Math.min(Math.max(((pixel[0] - a[0]) * d[0] + (pixel[1] - a[1]) * d[1]) / (d[0] ** 2 + d[1] ** 2 || 1), 0), 1);
      if (off([a[0] + t * d[0], a[1] + t * d[1]]) < 8) return { ...found, wall };
    }
    return found;
  }

  toPixels(p) {
    return [
      (p[0] - this.centre[0]) * this.zoom + this.canvas.clientWidth / 2,
      (this.centre[1] - p[1]) * this.zoom + this.canvas.clientHeight / 2,
    ];
  }

  toMetres(p) {
    return [
      (p[0] - this.canvas.clientWidth / 2) / this.zoom + this.centre[0],
      this.centre[1] - (p[1] - this.canvas.clientHeight / 2) / this.zoom,
    ];
  }

  draw() {
    if (!this.scene || !this.canvas.clientWidth) return;
    const { context: c } = this, ratio = window.devicePixelRatio || 1;
    const style = getComputedStyle(document.documentElement);
    this.colour = (name) => style.getPropertyValue(`--${name}`).trim();
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, this.canvas.clientWidth, this.canvas.clientHeight);
    c.lineJoin = c.lineCap = "round";
    this.scene.coverage?.draw(this);
    this.grid();
    if (this.scene.showTruth && this.scene.truth) this.truth(this.scene.truth);
    if (this.scene.state) {
      if (this.scene.showCandidates) this.candidates();
      this.estimates();
    }
    this.scene.other?.draw(this); // on top: where both went the same way, both are seen
  }

  grid() {
    const { context: c } = this;
    const raw = 90 / this.zoom, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((m) => m * power).find((m) => m >= raw);
    const [left, top] = this.toMetres([0, 0]);
    const [right, bottom] = this.toMetres([this.canvas.clientWidth, this.canvas.clientHeight]);
    c.strokeStyle = this.colour("line");
    c.fillStyle = this.colour("muted");
    c.lineWidth = 0.6;
    c.font = "11px system-ui, sans-serif";
    c.textAlign = "left";
    const label = (value) => `${+value.toPrecision(6)} m`;
    for (let x = Math.ceil(left / step) * step; x < right; x += step) {
      const [u] = this.toPixels([x, 0]);
      this.path([[u, 0], [u, this.canvas.clientHeight]]);
      c.fillText(label(x), u + 3, 12);
    }
    for (let y = Math.ceil(bottom / step) * step; y < top; y += step) {
      const [, v] = this.toPixels([0, y]);
      this.path([[0, v], [this.canvas.clientWidth, v]]);
      if (v > 26) c.fillText(label(y), 4, v - 3);
    }
  }

  path(pixels) {
    const { context: c } = this;
    c.beginPath();
    pixels.forEach(([u, v], i) => (i ? c.lineTo(u, v) : c.moveTo(u, v)));
    c.stroke();
  }

  // A track from an epoch on in pixels, without what lies on one and the same of them.
  thinned(track, first, place = this.scene.place) {
    const kept = [];
    let last = [Infinity, Infinity];
    for (let i = first; i < track.length; i++) {
      const at = this.toPixels(place(track[i]));
      if (i < track.length - 1 && Math.abs(at[0] - last[0]) < 0.7 && Math.abs(at[1] - last[1]) < 0.7) continue;
      kept.push(at);
      last = at;
    }
    return kept;
  }

  // The track on a canvas of its own: as long as the view stays, only what is new is drawn.
  drawTrack(track, colour) {
    const ratio = window.devicePixelRatio || 1, { width, height } = this.canvas;
    const key = [...this.centre, this.zoom, width, height, colour].join();
    const same = this.layer?.key === key && this.layer.count <= track.length && this.layer.first === track[0];
    if (!same) {
      const canvas = this.layer?.canvas ?? document.createElement("canvas");
      [canvas.width, canvas.height] = [width, height]; // which empties it
      this.layer = { key, canvas, count: 0, first: track[0] };
    }
    if (this.layer.count < track.length) {
      const c = this.layer.canvas.getContext("2d");
      c.setTransform(ratio, 0, 0, ratio, 0, 0);
      [c.strokeStyle, c.lineWidth, c.lineJoin, c.lineCap] = [colour, 1.8, "round", "round"];
      c.beginPath();
      this.thinned(track, Math.max(this.layer.count - 1, 0)).forEach(([u, v], i) => (i ? c.lineTo(u, v) : c.moveTo(u, v)));
      c.stroke();
      this.layer.count = track.length;
    }
    this.context.save();
    this.context.setTransform(1, 0, 0, 1, 0, 0);
    this.context.drawImage(this.layer.canvas, 0, 0);
    this.context.restore();
  }

  truth(truth) {
    const { context: c } = this;
    c.strokeStyle = c.fillStyle = this.colour("true");
    c.lineWidth = 6;
    for (const wall of truth.walls) this.path([this.toPixels(wall.from_m), this.toPixels(wall.to_m)]);
    c.lineWidth = 3.5;
    c.globalAlpha = 0.6;
    this.path(truth.track_m.map((p) => this.toPixels(p)));
    c.globalAlpha = 1;
    for (const anchor of truth.anchors_m) this.triangle(this.toPixels(anchor), 11);
  }

  // What else may be: walls and places of the hypotheses, the fainter the less likely.
  candidates() {
    const { context: c, scene } = this, { state, track, place } = scene;
    const anchors = state.anchors.filter((anchor) => anchor.located).map((anchor) => anchor.position_m);
    const walked = this.sampled(track);
    const found = new Map(state.walls.map((wall) => [wall.id, wall.vrp_m]));
    const known = ({ id, vrp_m }) => found.has(id) && norm(add(vrp_m, scale(found.get(id), -1))) < 0.5;
    for (const [i, candidate] of state.candidates.entries()) {
      c.globalAlpha = 0.2 + 0.5 * candidate.weight;
      c.strokeStyle = this.colour("wall");
      c.lineWidth = 2;
      c.setLineDash([2, 6]);
      for (const wall of candidate.walls) {
        if (known(wall)) continue;
        const { foot, tangent } = line(wall.vrp_m);
        const at = (t) => this.toPixels(place(add(foot, scale(tangent, t))));
        this.path(seen(wall.vrp_m, anchors, walked).map(at));
      }
      c.setLineDash([]);
      if (i === 0) continue;
      c.strokeStyle = this.colour("agent");
      c.lineWidth = 1.2;
      c.beginPath();
      c.arc(...this.toPixels(place(candidate.position_m)), 5, 0, 2 * Math.PI);
      c.stroke();
    }
    c.globalAlpha = 1;
  }

  estimates() {
    const { context: c, scene } = this, { state, track, place, enlarge } = scene;
    const wallColour = this.colour("wall"), agentColour = this.colour("agent"), anchorColour = this.colour("anchor");
    this.seenWalls = this.walls();
    for (const wall of this.seenWalls) {
      c.strokeStyle = c.fillStyle = wallColour;
      c.globalAlpha = 0.35;
      c.lineWidth = 1;
      c.setLineDash([5, 6]);
      const far = 4000 / this.zoom;
      this.path([this.toPixels(wall.at(-far)), this.toPixels(wall.at(far))]);
      c.setLineDash([]);
      c.globalAlpha = 0.18;
      const ts = Array.from({ length: 25 }, (_, i) => wall.low + ((wall.high - wall.low) * i) / 24);
      const edge = (t, sign) => this.toPixels(wall.at(t, sign * 2 * enlarge * across(wall.vrp_m, wall.covariance_m2, t)));
      c.beginPath();
      [...ts.map((t) => edge(t, 1)), ...ts.reverse().map((t) => edge(t, -1))]
        .forEach(([u, v], i) => (i ? c.lineTo(u, v) : c.moveTo(u, v)));
      c.fill();
      c.globalAlpha = 1;
      c.lineWidth = scene.selected?.wall === wall.id ? 5 : 2.4;
      this.path(wall.ends.map((p) => this.toPixels(p)));
    }
    if (track.length) this.drawTrack(track, agentColour);
    for (const anchor of state.anchors) {
      if (!anchor.located) continue;
      const at = this.toPixels(place(anchor.position_m));
      this.ellipse(at, anchor.covariance_m2, anchorColour);
      c.fillStyle = anchorColour;
      this.triangle(at, scene.selected?.anchor === anchor.name ? 10 : 6.5);
      c.textAlign = "center";
      c.font = "12px system-ui, sans-serif";
      c.fillText(anchor.name, at[0], at[1] - 12);
    }
    const cov = state.agent.covariance, lost = state.integrity?.state === "lost";
    const at = this.toPixels(place(state.agent.position_m));
    this.ellipse(at, [[cov[0][0], cov[0][1]], [cov[1][0], cov[1][1]]], agentColour);
    this.protection(at, state.integrity, lost ? anchorColour : agentColour);
    c.fillStyle = lost ? anchorColour : agentColour;
    c.strokeStyle = this.colour("ground");
    c.lineWidth = 2;
    c.beginPath();
    c.arc(at[0], at[1], 6, 0, 2 * Math.PI);
    c.fill();
    c.stroke();
    if (lost) this.path([[at[0] - 3, at[1] - 3], [at[0] + 3, at[1] + 3]]), this.path([[at[0] + 3, at[1] - 3], [at[0] - 3, at[1] + 3]]);
  }

  // The circle that the agent is within with 99.9 % probability, where the engine tells.
  protection([u, v], integrity, colour) {
    const radius = this.zoom * (integrity?.protection_level_m ?? 0), { context: c } = this;
    if (radius < 8 || radius > 1e5) return;
    c.strokeStyle = colour;
    c.lineWidth = integrity.state === "ok" ? 1 : 2;
    c.setLineDash([6, 4]);
    c.beginPath();
    c.arc(u, v, radius, 0, 2 * Math.PI);
    c.stroke();
    c.setLineDash([]);
  }

  ellipse([u, v], covariance, colour) {
    const { context: c, scene } = this, { major, minor, angle } = ellipse(covariance);
    const size = 2 * scene.enlarge * this.zoom;
    c.fillStyle = colour;
    c.globalAlpha = 0.25;
    c.beginPath();
    c.ellipse(u, v, Math.max(major * size, 1), Math.max(minor * size, 1), -(angle + scene.heading), 0, 2 * Math.PI);
    c.fill();
    c.globalAlpha = 1;
  }

  triangle([u, v], size, hollow = false) {
    const { context: c } = this;
    c.beginPath();
    c.moveTo(u, v - size);
    c.lineTo(u + 0.87 * size, v + 0.5 * size);
    c.lineTo(u - 0.87 * size, v + 0.5 * size);
    c.closePath();
    if (hollow) c.stroke();
    else c.fill();
  }
}
