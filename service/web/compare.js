// Another session beside the one that is shown: its track, walls and anchors at the same time.

import { get } from "./api.js";
import { add, frame, line, scale, seen } from "./geometry.js";

export class Other {
  // Reads a session to be drawn in the frame of another; both in the plan's where both know it.
  static async open(id, own) {
    const path = `/v1/sessions/${id}`;
    const [session, columns] = await Promise.all([get(path), get(`${path}/trajectory`)]);
    return new Other(path, session, columns, own);
  }

  constructor(path, session, columns, own) {
    this.path = path;
    this.name = session.name || session.id.slice(0, 8);
    this.columns = columns;
    this.walked = columns.x_m.map((x, i) => [x, columns.y_m[i]]);
    const shared = Boolean(own.start_frame && session.start_frame);
    this.place = frame(shared ? session.start_frame : own.start_frame).place;
    this.state = null;
    this.epoch = -1;
  }

  // The last epoch at a time or before it; -1 if it begins later.
  at(time_s) {
    let low = 0, high = this.columns.time_s.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.columns.time_s[middle] <= time_s) low = middle + 1;
      else high = middle;
    }
    return low - 1;
  }

  // Where the agent was at a time in the frame of the map; null before the first epoch.
  where(time_s) {
    const i = this.at(time_s);
    return i < 0 ? null : this.place(this.walked[i]);
  }

  // Reads the estimate at a time; of several questions on their way only the last counts.
  async seek(time_s) {
    const epoch = this.at(time_s);
    if (epoch === this.epoch) return;
    this.epoch = epoch;
    const state = epoch < 0 ? null : await get(`${this.path}/state?epoch=${epoch}`);
    if (epoch === this.epoch) this.state = state;
  }

  // Draws it on a map: thin, hollow, in a colour of its own.
  draw(map) {
    const { context: c } = map, track = this.walked.slice(0, this.epoch + 1);
    c.strokeStyle = map.colour("other");
    c.lineWidth = 1.4;
    if (track.length) map.path(map.thinned(track, 0, this.place));
    const anchors = (this.state?.anchors ?? []).filter((anchor) => anchor.located).map((anchor) => anchor.position_m);
    const walked = map.sampled(track);
    c.setLineDash([9, 4]);
    for (const wall of this.state?.walls ?? []) {
      const { foot, tangent } = line(wall.vrp_m);
      const ends = seen(wall.vrp_m, anchors, walked).map((t) => this.place(add(foot, scale(tangent, t))));
      map.path(ends.map((p) => map.toPixels(p)));
    }
    c.setLineDash([]);
    for (const anchor of anchors) map.triangle(map.toPixels(this.place(anchor)), 8, true);
    if (!track.length) return;
    c.beginPath();
    c.arc(...map.toPixels(this.place(track[track.length - 1])), 6, 0, 2 * Math.PI);
    c.stroke();
  }
}
