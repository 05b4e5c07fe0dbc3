// One session: its live map, the replay, the plots.

import { download, events, get } from "./api.js";
import { Other } from "./compare.js";
import { Coverage } from "./coverage.js";
import { frame, norm } from "./geometry.js";
import { MapView } from "./map.js";
import { Plot } from "./plots.js";

const $ = (id) => document.getElementById(id);
const COLUMNS = ["time_s", "x_m", "y_m", "variance_x_m2", "variance_y_m2", "rotation_std_rad", "hypotheses", "walls"];
const KEPT = 400; // states kept for the replay
const STALE_S = 15; // without a new epoch, after which what is shown no longer counts as live

export class SessionView {
  constructor(notice) {
    this.notice = notice;
    this.map = new MapView($("map"));
    const pick = (epoch) => this.seek(epoch);
    this.plots = {
      position: new Plot($("plot-position"), "Position, m", [
        { label: "claimed std", colour: "agent" }, { label: "error", colour: "anchor" }, { label: "apart", colour: "other" },
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
    $("coverage").onchange = () => this.cover().catch((error) => {
      $("coverage").checked = false;
      this.notice(error);
    });
    $("slider").oninput = () => this.seek(+$("slider").value);
    $("live").onclick = () => this.goLive();
    $("play").onclick = () => this.play();
    this.map.onHover = (found) => this.tell(found);
    this.map.onPick = (found) => {
      if (found.epoch !== undefined) this.seek(found.epoch);
      else this.select(found.anchor ? { anchor: found.anchor.name } : found.wall ? { wall: found.wall.id } : null);
    };
    for (const [table, kind] of [["anchors", "anchor"], ["walls", "wall"]]) {
      $(table).onclick = (event) => {
        const row = event.target.closest("tbody tr");
        if (row) this.select({ [kind]: kind === "wall" ? +row.dataset.name : row.dataset.name });
      };
    }
    $("other").onfocus = () => this.offerOthers().catch(this.notice);
    $("other").onchange = () => {
      const chosen = $("other").value;
      history.replaceState(null, "", `#/s/${this.session.id}${chosen ? `?with=${chosen}` : ""}`);
      this.compare(chosen).catch(this.notice);
    };
    this.beat = setInterval(() => this.tellLink(), 1000);
  }

  // What is selected stands out in map and tables; the same again, or nothing, ends that.
  select(what) {
    const same = what && JSON.stringify(what) === JSON.stringify(this.selected);
    this.selected = same ? null : what;
    this.draw();
  }

  // What lies under the pointer, with its values; how far that is from what is selected.
  tell(found) {
    $("tip").hidden = !found;
    if (!found) return;
    const [x, y] = found.at, lines = [`${x.toFixed(2)}, ${y.toFixed(2)} m`];
    if (found.anchor) lines.unshift(`${found.anchor.name}: ± ${spread(found.anchor.covariance_m2)} m, exists ${percent(found.anchor.existence)}`);
    if (found.wall) lines.unshift(`wall ${found.wall.id}: ${(norm(found.wall.vrp_m) / 2).toFixed(2)} m from the start, exists ${percent(found.wall.existence)}`);
    if (found.epoch !== undefined) {
      const c = this.columns, i = found.epoch;
      lines.unshift(`epoch ${i}, ${c.time_s[i].toFixed(1)} s: ± ${Math.sqrt(c.variance_x_m2[i] + c.variance_y_m2[i]).toFixed(3)} m`);
    }
    const from = this.selectedPlace();
    if (from) lines.push(`${Math.hypot(x - from[0], y - from[1]).toFixed(2)} m from ${this.selected.anchor}`);
    $("tip").textContent = lines.join("\n");
  }

  selectedPlace() {
    const anchor = this.state?.anchors.find((each) => each.name === this.selected?.anchor);
    return anchor?.located ? this.frame.place(anchor.position_m) : null;
  }

  // Whether what is shown is live, has not changed for a while, or cannot be heard of.
  tellLink() {
    if (!this.session || $("session").hidden) return;
    const silent = (Date.now() - this.heard) / 1000;
    const state = this.linked === false ? "lost" : silent < STALE_S && this.live ? "live" : "stale";
    const since = silent < 120 ? `${Math.round(silent)} s` : `${Math.round(silent / 60)} min`;
    const words = { live: "live", stale: this.live ? `no new epoch for ${since}` : "replay", lost: `disconnected for ${since}, trying again` };
    $("link").dataset.state = state;
    $("link").textContent = words[state];
  }

  // The sessions that this one may be compared with.
  async offerOthers() {
    const chosen = $("other").value, page = await get("/v1/sessions?limit=100");
    const others = page.sessions.filter(({ id }) => id !== this.session.id);
    $("other").replaceChildren(new Option("nothing", ""), ...others.map(({ id, name }) => new Option(name || id.slice(0, 8), id)));
    if (chosen && !others.some(({ id }) => id === chosen)) $("other").append(new Option(this.other?.name ?? chosen.slice(0, 8), chosen));
    $("other").value = chosen;
  }

  // Shows another session beside this one, or none.
  async compare(id) {
    const other = id ? await Other.open(id, this.session) : null;
    this.other = other;
    $("other-legend").hidden = !other;
    $("other-legend").textContent = other ? `${other.name}, thin and hollow` : "";
    if (other && $("other").value !== id) {
      $("other").append(new Option(other.name, id));
      $("other").value = id;
    }
    await this.seekOther();
    this.changed();
  }

  // What the map predicts of channels, as of the latest epoch when it was asked for; nothing if it is not wanted.
  async cover() {
    this.coverage = null;
    $("coverage-legend").textContent = "predicted coverage";
    if ($("coverage").checked) {
      $("coverage-legend").textContent = "predicting coverage …";
      const { path, epoch } = this;
      const found = await get(`${path}/coverage`).finally(() => ($("coverage-legend").textContent = "predicted coverage"));
      if (path !== this.path) return;
      this.coverage = new Coverage(found);
      $("coverage-legend").textContent = `${this.coverage.text} (epoch ${epoch})`;
    }
    this.draw();
  }

  async seekOther() {
    const time_s = this.columns.time_s[this.epoch];
    if (this.other && time_s !== undefined) await this.other.seek(time_s);
  }

  async open(id, beside) {
    this.close();
    this.other = null;
    this.coverage = null;
    $("coverage").checked = false;
    $("coverage-legend").textContent = "predicted coverage";
    $("other").value = "";
    $("other-legend").hidden = true;
    this.stop = new AbortController();
    this.path = `/v1/sessions/${id}`;
    const [session, truth, trajectory] = await Promise.all([
      get(this.path), get(`${this.path}/truth`), get(`${this.path}/trajectory`),
    ]);
    this.session = session;
    this.frame = frame(session.start_frame);
    this.truth = truth && this.placedTruth(truth);
    this.columns = Object.fromEntries(COLUMNS.map((name) => [name, trajectory[name]]));
    this.walked = this.columns.x_m.map((x, i) => [x, this.columns.y_m[i]]);
    this.states = new Map();
    this.epoch = this.count - 1;
    this.state = null;
    this.live = true;
    this.linked = true;
    this.heard = Date.parse(session.updated_at);
    this.selected = null;
    this.map.touched = false;
    document.title = `${session.name || id.slice(0, 8)} · hapslam`;
    $("name").textContent = session.name || id.slice(0, 8);
    $("subtitle").textContent = `${session.method}, ${session.engine} engine`;
    if (session.warnings?.length) this.notice(session.warnings.join(" "), true);
    this.links(id);
    if (this.count) await this.load(this.epoch);
    this.changed();
    this.offerOthers().then(() => beside && this.compare(beside)).catch(this.notice);
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
      ["mcap", "export?format=mcap", "result.mcap"], ["tum", "export?format=tum", "track.txt"],
      ["smoothed", "smoothed", "smoothed.json"], ["twin", "twin", "twin.toml"], ["export", "export", "result.nc"], ["log", "measurements", "measurements.nc"],
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
      const link = (up) => {
        this.linked = up;
        this.tellLink();
      };
      for await (const state of events(`${this.path}/events`, this.count, signal, link)) {
        this.append(state);
        this.heard = Date.now();
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
    this.walked.push([row.x_m, row.y_m]);
    this.keep(state);
    if (this.live) {
      this.epoch = state.epoch;
      this.state = state;
      this.seekOther().then(() => this.other && this.changed(), this.notice);
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
    await Promise.all([this.load(this.epoch), this.seekOther()]).catch(this.notice);
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
      else this.seek(Math.min(this.epoch + step * +$("speed").value, this.count - 1));
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
    const at = this.columns.time_s[this.epoch];
    $("when").textContent = at === undefined ? "" : `${at.toFixed(1)} s`;
    const track = this.walked.slice(0, this.epoch + 1);
    this.map.show({
      state: this.state, track, selected: this.selected, place: this.frame.place, heading: this.frame.heading, truth: this.truth, other: this.other,
      coverage: this.coverage,
      showTruth: $("truth").checked, showCandidates: $("candidates").checked, enlarge: +$("enlarge").value,
    });
    this.facts();
    this.mark();
    this.tellLink();
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
      const apart = this.apart(this.epoch);
      if (apart != null) rows.push([`From ${this.other.name}`, `${apart.toFixed(3)} m`]);
      const { integrity } = state;
      if (integrity?.protection_level_m != null) rows.push(["99.9 % within", `${integrity.protection_level_m.toFixed(2)} m`]);
      if (integrity && integrity.state !== "unknown") rows.push(["Integrity", integrity.state]);
      rows.push(["Rotation ±", `${(1e3 * state.rotation_std_rad).toFixed(2)} mrad`]);
      rows.push(["Anchors", `${state.anchors.filter((a) => a.located).length} of ${state.anchors.length} located`]);
      rows.push(["Hypotheses", state.candidates.length > 1
        ? `${state.hypotheses}, the likeliest ${percent(state.candidates[0].weight)}` : String(state.hypotheses)]);
    }
    $("facts").replaceChildren(...rows.flatMap(([name, value]) => [text("dt", name), text("dd", value)]));
    this.tellIntegrity(state?.integrity);
    this.anchorTable(state?.anchors ?? []);
    $("walls").tBodies[0].replaceChildren(...(state?.walls ?? []).map((wall) => {
      const c = wall.covariance_m2;
      const bearing = (180 / Math.PI) * (Math.atan2(wall.vrp_m[1], wall.vrp_m[0]) + this.frame.heading);
      return tableRow(wall.id, this.selected?.wall === wall.id, [wall.id, (norm(wall.vrp_m) / 2).toFixed(2),
        (Math.round(10 * bearing) / 10 + 0).toFixed(1), (0.5 * Math.sqrt(c[0][0] + c[1][1])).toFixed(2), percent(wall.existence)]);
    }));
  }

  // Anchors with what is known of each; clocks and heights where the engine estimates them.
  anchorTable(anchors) {
    $("anchors").tBodies[0].replaceChildren(...anchors.flatMap((anchor) => {
      const place = anchor.located ? this.frame.place(anchor.position_m).map((v) => v.toFixed(2)).join(", ") : "not located";
      const selected = this.selected?.anchor === anchor.name;
      const row = tableRow(anchor.name, selected,
        [anchor.name, place, anchor.located ? spread(anchor.covariance_m2) : "–", percent(anchor.existence)]);
      const known = [["clock", "clock_bias"], ["height", "height"]].filter(([, name]) => anchor[`${name}_m`] != null)
        .map(([word, name]) => `${word} ${anchor[`${name}_m`].toFixed(2)} ± ${anchor[`${name}_std_m`].toFixed(2)} m`);
      if (!known.length) return [row];
      const more = tableRow(anchor.name, selected, [known.join(", ")]);
      more.className = "more";
      more.cells[0].colSpan = row.cells.length;
      return [row, more];
    }));
  }

  // Where the engine doubts itself, that stands above the map.
  tellIntegrity(integrity) {
    const doubted = integrity && ["doubtful", "lost"].includes(integrity.state);
    const name = this.session?.name || this.session?.id.slice(0, 8);
    if (name) document.title = `${doubted ? `${integrity.state.toUpperCase()}: ` : ""}${name} · hapslam`;
    $("integrity").hidden = !doubted;
    if (!doubted) return;
    $("integrity").dataset.state = integrity.state;
    const what = integrity.state === "lost" ? "Lost: do not rely on this position" : "Doubtful";
    const reasons = integrity.reasons.length ? `: ${integrity.reasons.join("; ")}` : "";
    $("integrity").textContent = what + reasons;
  }

  // How far from the other session's agent at the same time; null without one.
  apart(i) {
    const at = this.other?.where(this.columns.time_s[i]);
    if (!at) return null;
    const own = this.frame.place(this.walked[i]);
    return Math.hypot(own[0] - at[0], own[1] - at[1]);
  }

  error(i) {
    const true_ = this.truth?.local[i];
    return true_ ? Math.hypot(this.columns.x_m[i] - true_[0], this.columns.y_m[i] - true_[1]) : null;
  }

  drawPlots() {
    const c = this.columns, each = (f) => c.time_s.map((_, i) => f(i));
    this.plots.position.show([c.time_s, each((i) => Math.sqrt(c.variance_x_m2[i] + c.variance_y_m2[i])), each((i) => this.error(i)), each((i) => this.apart(i))]);
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

function spread([[a], [, d]]) {
  return Math.sqrt(a + d).toFixed(2);
}

function tableRow(name, selected, cells) {
  const row = document.createElement("tr");
  row.dataset.name = name;
  row.setAttribute("aria-selected", String(selected));
  row.append(...cells.map((content) => text("td", content)));
  return row;
}

function text(tag, content) {
  const element = document.createElement(tag);
  element.textContent = content;
  return element;
}
