// One session: its live map, the replay, the plots.

import { download, events, get } from "./api.js";
import { frame, norm } from "./geometry.js";
import { MapView } from "./map.js";
import { Plot } from "./plots.js";

const $ = (id) => document.getElementById(id);
const COLUMNS = ["time_s", "x_m", "y_m", "variance_x_m2", "variance_y_m2", "rotation_std_rad", "hypotheses", "walls"];
const KEPT = 400; // states kept for the replay

export class SessionView {
  constructor(notice) {
    this.notice = notice;
    this.map = new MapView($("map"));
    const pick = (epoch) => this.seek(epoch);
    this.plots = {
      position: new Plot($("plot-position"), "Position, m", [
        { label: "claimed std", colour: "agent" }, { label: "error", colour: "anchor" },
      ], pick),
      rotation: new Plot($("plot-rotation"), "Rotation of the map, mrad", [{ label: "claimed std", colour: "wall" }], pick),
      counts: new Plot($("plot-counts"), "Walls and hypotheses", [
        { label: "walls", colour: "wall" }, { label: "hypotheses", colour: "muted", width: 1 },
      ], pick),
    };
    $("zoom-in").onclick = () => this.map.closer(1.4);
    $("zoom-out").onclick = () => this.map.closer(1 / 1.4);
    $("fit").onclick = () => this.map.fitAgain();
    for (const id of ["truth", "candidates", "enlarge"]) $(id).onchange = () => this.draw();
    $("slider").oninput = () => this.seek(+$("slider").value);
    $("live").onclick = () => this.goLive();
    $("play").onclick = () => this.play();
  }

  async open(id) {
    this.close();
    this.stop = new AbortController();
    this.path = `/v1/sessions/${id}`;
    const [session, truth, trajectory] = await Promise.all([
      get(this.path), get(`${this.path}/truth`), get(`${this.path}/trajectory`),
    ]);
    this.session = session;
    this.frame = frame(session.start_frame);
    this.truth = truth && this.placedTruth(truth);
    this.columns = Object.fromEntries(COLUMNS.map((name) => [name, trajectory[name]]));
    this.states = new Map();
    this.epoch = this.count - 1;
    this.state = null;
    this.live = true;
    this.map.touched = false;
    $("name").textContent = session.name || id.slice(0, 8);
    $("subtitle").textContent = `${session.method}, ${session.engine} engine, seed ${session.seed}; anchors ${session.anchors.join(", ")}`;
    this.links(id);
    if (this.count) await this.load(this.epoch);
    this.changed();
    this.follow(this.stop.signal);
  }

  close() {
    this.stop?.abort();
    clearInterval(this.timer);
    this.timer = null;
    $("play").textContent = "▶";
  }

  get count() {
    return this.columns.time_s.length;
  }

  placedTruth(truth) {
    const plan = truth.frame === "plan" ? frame(truth.start_frame ?? this.session.start_frame) : frame(null);
    const move = (p) => this.frame.place(plan.back(p));
    return {
      walls: truth.walls.map((wall) => ({ ...wall, from_m: move(wall.from_m), to_m: move(wall.to_m) })),
      anchors_m: truth.anchors_m.map(move),
      track_m: truth.track_m.map(move),
      local: truth.track_m.map(plan.back),
    };
  }

  links(id) {
    for (const [name, leaf, file] of [
      ["png", "map.png", "map.png"], ["svg", "map.svg", "map.svg"], ["geojson", "map?format=geojson", "map.geojson"],
      ["smoothed", "smoothed", "smoothed.json"], ["export", "export", "result.nc"], ["log", "measurements", "measurements.nc"],
    ]) {
      $(name).href = `${this.path}/${leaf}`;
      $(name).onclick = (event) => {
        event.preventDefault();
        download(`${this.path}/${leaf}`, `${id.slice(0, 8)}-${file}`).catch(this.notice);
      };
    }
  }

  async follow(signal) {
    try {
      for await (const state of events(`${this.path}/events`, this.count, signal)) {
        this.append(state);
      }
      if (!signal.aborted) this.notice("This session was deleted.");
    } catch (error) {
      this.notice(error);
    }
  }

  append(state) {
    if (state.epoch !== this.count) return;
    const cov = state.agent.covariance;
    const row = {
      time_s: state.time_s, x_m: state.agent.position_m[0], y_m: state.agent.position_m[1],
      variance_x_m2: cov[0][0], variance_y_m2: cov[1][1], rotation_std_rad: state.rotation_std_rad,
      hypotheses: state.hypotheses, walls: state.walls.length,
    };
    for (const name of COLUMNS) this.columns[name].push(row[name]);
    this.keep(state);
    if (this.live) {
      this.epoch = state.epoch;
      this.state = state;
    }
    this.changed();
  }

  keep(state) {
    this.states.set(state.epoch, state);
    if (this.states.size > KEPT) this.states.delete(this.states.keys().next().value);
  }

  async load(epoch) {
    const known = this.states.get(epoch);
    const state = known ?? (await get(`${this.path}/state?epoch=${epoch}`));
    if (!known) this.keep(state);
    if (epoch === this.epoch) this.state = state;
  }

  async seek(epoch, live = false) {
    if (!this.count) return;
    this.live = live;
    this.epoch = Math.min(Math.max(epoch, 0), this.count - 1);
    this.draw();
    await this.load(this.epoch).catch(this.notice);
    this.draw();
  }

  goLive() {
    this.seek(this.count - 1, true);
  }

  play() {
    if (this.timer) {
      clearInterval(this.timer);
      this.timer = null;
      $("play").textContent = "▶";
      return;
    }
    if (this.epoch >= this.count - 1) this.epoch = 0;
    $("play").textContent = "❚❚";
    const step = Math.max(1, Math.round(this.count / 400));
    this.timer = setInterval(() => {
      if (this.epoch >= this.count - 1) this.play();
      else this.seek(this.epoch + step);
    }, 60);
  }

  // Draws once a frame, however fast epochs come.
  changed() {
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = null;
      this.draw();
      this.drawPlots();
    });
  }

  draw() {
    const slider = $("slider");
    slider.max = Math.max(this.count - 1, 0);
    slider.value = this.epoch;
    $("live").setAttribute("aria-pressed", String(this.live));
    const track = [];
    for (let i = 0; i <= this.epoch; i++) track.push([this.columns.x_m[i], this.columns.y_m[i]]);
    this.map.show({
      state: this.state, track, place: this.frame.place, heading: this.frame.heading, truth: this.truth,
      showTruth: $("truth").checked, showCandidates: $("candidates").checked, enlarge: +$("enlarge").value,
    });
    this.facts();
    this.mark();
  }

  mark() {
    for (const plot of Object.values(this.plots)) plot.mark(this.epoch);
  }

  facts() {
    const { state } = this, rows = [["Epoch", this.count ? `${this.epoch} of ${this.count - 1}` : "none yet"]];
    if (state) {
      const cov = state.agent.covariance, [x, y] = this.frame.place(state.agent.position_m);
      rows.push(["Time", `${state.time_s.toFixed(1)} s`]);
      rows.push(["Position", `${x.toFixed(2)}, ${y.toFixed(2)} m`]);
      rows.push(["± std", `${Math.sqrt(cov[0][0] + cov[1][1]).toFixed(3)} m`]);
      const error = this.error(state.epoch);
      if (error != null) rows.push(["Error", `${error.toFixed(3)} m`]);
      rows.push(["Rotation ±", `${(1e3 * state.rotation_std_rad).toFixed(2)} mrad`]);
      rows.push(["Anchors", `${state.anchors.filter((a) => a.located).length} of ${state.anchors.length} located`]);
      rows.push(["Hypotheses", state.candidates.length > 1
        ? `${state.hypotheses}, the likeliest ${percent(state.candidates[0].weight)}` : String(state.hypotheses)]);
    }
    $("facts").replaceChildren(...rows.flatMap(([name, value]) => [text("dt", name), text("dd", value)]));
    $("walls").tBodies[0].replaceChildren(...(state?.walls ?? []).map((wall) => {
      const row = document.createElement("tr"), c = wall.covariance_m2;
      const bearing = (180 / Math.PI) * (Math.atan2(wall.vrp_m[1], wall.vrp_m[0]) + this.frame.heading);
      row.append(text("td", wall.id), text("td", (norm(wall.vrp_m) / 2).toFixed(2)), text("td", (Math.round(10 * bearing) / 10 + 0).toFixed(1)),
        text("td", (0.5 * Math.sqrt(c[0][0] + c[1][1])).toFixed(2)), text("td", percent(wall.existence)));
      return row;
    }));
  }

  error(i) {
    const true_ = this.truth?.local[i];
    return true_ ? Math.hypot(this.columns.x_m[i] - true_[0], this.columns.y_m[i] - true_[1]) : null;
  }

  drawPlots() {
    const c = this.columns, each = (f) => c.time_s.map((_, i) => f(i));
    this.plots.position.show([c.time_s, each((i) => Math.sqrt(c.variance_x_m2[i] + c.variance_y_m2[i])), each((i) => this.error(i))]);
    this.plots.rotation.show([c.time_s, each((i) => 1e3 * c.rotation_std_rad[i])]);
    this.plots.counts.show([c.time_s, c.walls, c.hypotheses]);
    this.mark();
  }

  restyle() {
    for (const plot of Object.values(this.plots)) plot.restyle();
    if (this.columns) this.changed();
  }
}

function percent(share) {
  return `${Math.floor(100 * share + 1e-9)} %`;
}

function text(tag, content) {
  const element = document.createElement(tag);
  element.textContent = content;
  return element;
}
