// Uncertainty, error and counts over time.

const { uPlot } = window; // /web/uplot.js, a classic script

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

export class Plot {
  constructor(element, title, series, onPick) {
    this.element = element;
    this.title = title;
    this.series = series;
    this.onPick = onPick;
    this.data = [[], ...series.map(() => [])];
    new ResizeObserver(() => this.plot?.setSize(this.size())).observe(element);
    this.restyle();
  }

  size() {
    return { width: Math.max(this.element.clientWidth, 200), height: 190 };
  }

  restyle() {
    this.plot?.destroy();
    const axis = { stroke: colour("muted"), grid: { stroke: colour("line"), width: 0.6 }, ticks: { show: false }, size: 46 };
    this.plot = new uPlot({
      ...this.size(),
      title: this.title,
      scales: { x: { time: false } },
      cursor: { y: false, points: { show: false }, drag: { x: true, y: false } },
      series: [
        { label: "time, s" },
        ...this.series.map(({ label, colour: name, width = 1.5 }) => ({
          label, stroke: colour(name), width, points: { show: false },
          value: (_, v) => (v == null ? "–" : Number.isInteger(v) ? v : v.toPrecision(3)),
        })),
      ],
      axes: [{ ...axis, size: 30 }, axis],
    }, this.data, this.element);
    this.plot.over.addEventListener("click", () => {
      if (this.plot.cursor.idx != null) this.onPick(this.plot.cursor.idx);
    });
  }

  show(data) {
    this.data = data;
    this.plot.setData(data);
  }

  // Puts the cursor, and with it the figures below, at an epoch.
  mark(epoch) {
    if (epoch in this.data[0]) this.plot.setCursor({ left: this.plot.valToPos(this.data[0][epoch], "x"), top: 0 });
  }
}
