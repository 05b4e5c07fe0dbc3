// Points are [x, y] in metres. A wall is given by its VRP, the mirror image of the agent's start.

export const add = (a, b) => [a[0] + b[0], a[1] + b[1]];
export const scale = (a, s) => [a[0] * s, a[1] * s];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1];
export const norm = (a) => Math.hypot(a[0], a[1]);

// The frame in which a map is drawn: the floor plan's if the start in it is known.
export function frame(start) {
  const [x, y] = start?.position_m ?? [0, 0];
  const c = Math.cos(start?.heading_rad ?? 0), s = Math.sin(start?.heading_rad ?? 0);
  return {
    place: (p) => [c * p[0] - s * p[1] + x, s * p[0] + c * p[1] + y],
    back: (p) => [c * (p[0] - x) + s * (p[1] - y), -s * (p[0] - x) + c * (p[1] - y)],
    heading: start?.heading_rad ?? 0,
  };
}

// Half axes and direction of a covariance's standard ellipse.
export function ellipse([[a, b], [, d]]) {
  const mean = (a + d) / 2, half = Math.hypot((a - d) / 2, b);
  return {
    major: Math.sqrt(Math.max(mean + half, 0)),
    minor: Math.sqrt(Math.max(mean - half, 0)),
    angle: 0.5 * Math.atan2(2 * b, a - d),
  };
}

// A wall's foot, normal and tangent; points on it are foot + t * tangent.
export function line(vrp) {
  const n = scale(vrp, 1 / norm(vrp));
  return { foot: scale(vrp, 0.5), normal: n, tangent: [-n[1], n[0]] };
}

// Standard deviation of a wall across itself at t metres from its foot.
export function across(vrp, covariance, t) {
  const { normal, tangent } = line(vrp), r = norm(vrp);
  const g = [normal[0] / 2 - (t * tangent[0]) / r, normal[1] / 2 - (t * tangent[1]) / r];
  const v = g[0] * (covariance[0][0] * g[0] + covariance[0][1] * g[1])
    + g[1] * (covariance[1][0] * g[0] + covariance[1][1] * g[1]);
  return Math.sqrt(Math.max(v, 0));
}

// From where to where on a wall the estimated reflection points lie, given anchors and track.
export function seen(vrp, anchors, track) {
  const { normal, tangent } = line(vrp), half = norm(vrp) / 2;
  const along = track.map((p) => dot(p, tangent)), before = track.map((p) => half - dot(p, normal));
  const openings = [];
  for (let i = 1; i < track.length; i++) {
    if ((before[i] > 0) !== (before[i - 1] > 0)) openings.push(along[i]);
  }
  let low = Infinity, high = -Infinity;
  for (const anchor of anchors) {
    const behind = half - dot(anchor, normal), at = dot(anchor, tangent); // of the anchor's image
    for (let i = 0; i < track.length; i++) {
      if (behind * before[i] <= 0) continue;
      const t = at + ((along[i] - at) * behind) / (behind + before[i]);
      if (t >= low && t <= high) continue;
      if (openings.some((opening) => Math.abs(t - opening) < 8)) continue;
      low = Math.min(low, t);
      high = Math.max(high, t);
    }
  }
  return low <= high ? [low, high] : [-0.1 * half, 0.1 * half];
}
