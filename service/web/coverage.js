// Predicted coverage under the map: one pixel a point, made once, drawn as an image in the estimator's frame.

const SPAN_DB = 40; // of the colours, below what 99 of 100 points are below
const STOPS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]]; // viridis

export class Coverage {
  constructor({ step_m, x_m, y_m, gain_db }) {
    const known = gain_db.flat().filter((gain) => gain !== null).sort((a, b) => a - b);
    this.top = known[Math.floor(0.99 * (known.length - 1))] ?? 0;
    this.text = `coverage, ${Math.round(this.top - SPAN_DB)} (dark) to ${Math.round(this.top)} dB (bright)`;
    this.corner = [(x_m[0] ?? 0) - step_m / 2, (y_m[0] ?? 0) - step_m / 2];
    this.step = step_m;
    this.image = document.createElement("canvas");
    [this.image.width, this.image.height] = [Math.max(x_m.length, 1), Math.max(y_m.length, 1)];
    const context = this.image.getContext("2d"), pixels = context.createImageData(this.image.width, this.image.height);
    gain_db.forEach((row, j) => row.forEach((gain, i) => {
      if (gain !== null) pixels.data.set([...this.colour(gain), 255], 4 * (j * this.image.width + i));
    }));
    context.putImageData(pixels, 0, 0);
  }

  colour(gain) {
    const at = Math.min(Math.max((gain - this.top) / SPAN_DB + 1, 0), 1) * (STOPS.length - 1), low = Math.min(Math.floor(at), STOPS.length - 2);
    return STOPS[low].map((value, i) => Math.round(value + (at - low) * (STOPS[low + 1][i] - value)));
  }

  // On a map view, whose frame may be turned against the estimator's.
  draw(map) {
    const { context: c, scene } = map, place = (x, y) => map.toPixels(scene.place([x, y]));
    const [x, y] = this.corner, origin = place(x, y), right = place(x + this.step, y), up = place(x, y + this.step);
    c.save();
    c.globalAlpha = 0.55;
    c.imageSmoothingEnabled = false;
    c.transform(right[0] - origin[0], right[1] - origin[1], up[0] - origin[0], up[1] - origin[1], ...origin);
    c.drawImage(this.image, 0, 0);
    c.restore();
  }
}
