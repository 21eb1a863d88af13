// Traces over time: uPlot on the page, the pens in files.

import { envelope } from "./records.js";

const LEFT = 54;
/// A shorter drag is a click.
const LEAST_DRAG = 4;

/// Traces that the fields of the records allow: title, unit, series (column, name, factor, colour, dash).
export function traces(records) {
  const { isDevice } = records, into = isDevice ? "into the device" : "of the hand into the tool", product = isDevice ? "\u2212F\u00b7v" : "F\u00b7v";
  const all = [
    { id: "force", title: isDevice ? "Force on the hand" : "Force of the hand", unit: "N", needs: "force_x_n", isFromZero: true, hasYield: true, series: [{ column: "force", name: "magnitude", scale: 1, color: "force" }] },
    { id: "power", title: `Power ${into}`, unit: "W", needs: "force_x_n", series: [{ column: "power", name: product, scale: 1, color: "power" }] },
    { id: "energy", title: `Energy ${into}`, unit: "J", needs: "force_x_n", series: [{ column: "energy", name: `integral of ${product}`, scale: 1, color: "energy" }] },
    { id: "error", title: "Following error", unit: "mrad", needs: "target_left_rad", series: [{ column: "left", name: "left", scale: 1000, color: "proxy" }, { column: "right", name: "right", scale: 1000, color: "tool", dash: [5, 3] }] },
    { id: "distance", title: "Distance from handle to proxy", unit: "mm", needs: "reported_x_m", isFromZero: true, series: [{ column: "distance", name: "distance", scale: 1000, color: "proxy" }] },
  ];
  return all.filter((trace) => records.has(trace.needs));
}

/// Range that holds the values with round ends. It keeps the earlier one while that fits, so that a live trace is calm.
function niceRange([low, high], earlier, isFromZero) {
  if (!(low <= high)) return earlier ?? [0, 1];
  const most = Math.max(high, 0), isAboveZero = isFromZero || low > -0.02 * most;
  const least = isAboveZero ? 0 : low;
  const span = Math.max(most - least, 1e-6);
  if (earlier && earlier[0] <= least && earlier[1] >= most && span > 0.35 * (earlier[1] - earlier[0])) return earlier;
  const rough = span / 6, power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 2.5, 5, 10].find((digit) => digit * power >= rough);
  return [Math.floor((least - (least < 0 ? span * 0.04 : 0)) / step) * step, Math.ceil((most + span * 0.04) / step) * step];
}

const label = (value) => String(Number(value.toPrecision(6))).replace("-", "\u2212");

export class Charts {
  /// `events`: seek(time), zoom(low, high), reset().
  constructor(parent, records, other, events) {
    const yieldOf = (shown) => shown?.machine.fixture?.yield_force_n;
    this.yield_n = yieldOf(records);
    /// Yield force of the other recording, if it differs.
    this.otherYield_n = yieldOf(other) === this.yield_n ? null : yieldOf(other);
    this.pending = new Set();
    this.charts = traces(records).map((trace) => ({ trace, parent: figure(parent, trace), plot: null, range: null, window: [0, 1], data: null, playhead: null }));
    this.events = events;
    this.sync = uPlot.sync("traces");
    this.observer = new ResizeObserver(() => this.resize());
    for (const chart of this.charts) this.observer.observe(chart.parent.body);
  }

  destroy() {
    this.observer.disconnect();
    for (const chart of this.charts) {
      chart.plot?.destroy();
      chart.parent.figure.remove();
    }
  }

  /// Makes every chart anew, as after a change of colours or of the recordings that are shown.
  build(colors, hasOther) {
    this.colors = colors;
    this.hasOther = hasOther;
    for (const chart of this.charts) {
      chart.plot?.destroy();
      chart.range = null;
      const body = chart.parent.body;
      chart.data = null;
      chart.plot = new uPlot(this.options(chart), null, body);
      const playhead = document.createElement("div");
      playhead.className = "playhead";
      chart.plot.over.append(playhead);
      chart.playhead = playhead;
      let pressed = 0;
      chart.plot.over.addEventListener("mousedown", (event) => { pressed = event.clientX; });
      chart.plot.over.addEventListener("click", (event) => {
        if (Math.abs(event.clientX - pressed) < LEAST_DRAG) this.events.seek(chart.plot.posToVal(event.offsetX, "x"));
      });
    }
  }

  options(chart) {
    const { colors } = this;
    const { width, height } = size(chart.parent.body);
    const { trace } = chart, isLast = chart === this.charts.at(-1);
    const series = (other) => trace.series.map(({ color, dash }) => ({
      stroke: other ? colors.other : colors[color],
      width: other ? 1.25 : 1.75,
      dash: other ? [3, 3] : dash,
      points: { show: false },
    }));
    const axis = { stroke: colors.muted, grid: { stroke: colors.grid, width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif" };
    return {
      width, height,
      padding: [8, 12, 0, 0],
      legend: { show: false },
      cursor: {
        y: false,
        points: { show: false },
        drag: { x: true, y: false, setScale: false },
        sync: { key: this.sync.key },
        bind: { dblclick: () => () => { this.events.reset(); return null; } },
      },
      scales: { x: { time: false, range: () => chart.window }, y: { range: () => chart.range ?? [0, 1] } },
      axes: [
        { ...axis, size: isLast ? 24 : 6, space: 60, values: (_, splits) => splits.map((value) => (isLast ? label(value) : "")) },
        { ...axis, size: LEFT, splits: () => ticks(chart.range ?? [0, 1], height > 110 ? 4 : 3), values: (_, splits) => splits.map(label) },
      ],
      series: [{}, ...series(false), ...(this.hasOther ? series(true) : [])],
      hooks: {
        setSelect: [(plot) => {
          if (plot.select.width < LEAST_DRAG) return;
          const from = plot.posToVal(plot.select.left, "x"), to = plot.posToVal(plot.select.left + plot.select.width, "x");
          plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          this.events.zoom(from, to);
        }],
        drawSeries: [(plot, which) => {
          if (which !== 1 || !trace.hasYield) return;
          for (const [yield_n, color] of this.yieldLines()) yieldLine(plot, yield_n, color);
        }],
      },
    };
  }

  /// Yield forces to draw, each with its colour.
  yieldLines() {
    return [[this.yield_n, this.colors.ink], [this.otherYield_n, this.colors.other]].filter(([yield_n]) => yield_n > 0);
  }

  resize() {
    for (const chart of this.charts) {
      const now = size(chart.parent.body);
      if (chart.plot && (chart.plot.width !== now.width || chart.plot.height !== now.height)) {
        chart.plot.setSize(now);
        this.pending.add(chart);
      }
    }
    this.events.changed();
  }

  markAll() { for (const chart of this.charts) this.pending.add(chart); }

  /// Draws at most `most` of the charts that wait for it. Returns whether some still wait.
  draw(window, main, other, most) {
    for (const chart of [...this.pending].slice(0, most)) {
      this.pending.delete(chart);
      this.update(chart, window, main, other);
      chart.plot?.setData(chart.data);
    }
    return this.pending.size > 0;
  }

  update(chart, window, main, other) {
    const { trace } = chart, width = Math.max(50, Math.floor(size(chart.parent.body).width - LEFT));
    const of = ({ records, offset }) => trace.series.map(({ column, scale }) => ({ records, column, scale, offset }));
    const series = [...of(main), ...(other ? of(other) : [])];
    chart.window = window;
    chart.data = envelope(window[0], window[1], width, series);
    let low = Infinity, high = trace.hasYield ? Math.max(...this.yieldLines().map(([yield_n]) => yield_n * 1.05)) : -Infinity;
    for (const values of chart.data.slice(1)) {
      for (const value of values) {
        if (value === null || value === undefined) continue;
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    chart.range = niceRange([Math.min(low, high), high], chart.range, trace.isFromZero);
  }

  /// Puts the line of the shown record's time at its place, and hides it where it says nothing.
  moveTo(time, isShown) {
    for (const { plot, playhead, window } of this.charts) {
      if (!plot || !playhead) continue;
      const isInside = isShown && time >= window[0] && time <= window[1];
      playhead.hidden = !isInside;
      // uPlot takes a new window after this frame's script: its own scale may be that of the earlier one.
      const share = (time - window[0]) / (window[1] - window[0]);
      if (isInside) playhead.style.transform = `translateX(${(share * plot.bbox.width) / devicePixelRatio}px)`;
    }
  }

  /// Writes the values of the shown record beside the titles.
  write(records, index) {
    for (const { trace, parent } of this.charts) {
      trace.series.forEach(({ column, scale }, k) => {
        const value = records.column(column, index) * scale;
        parent.values[k].textContent = Number.isFinite(value) ? `${value.toFixed(digits(trace.unit))} ${trace.unit}` : `no value`;
      });
    }
  }

  /// Draws the traces with a pen, one below the other.
  export(pen, box, window, main, other, time) {
    const height = box.height / this.charts.length;
    this.charts.forEach((chart, k) => {
      this.update(chart, window, main, other);
      exported(pen, { x: box.x, y: box.y + k * height, width: box.width, height: height - 12 }, chart, this, time);
    });
  }
}

function digits(unit) {
  return unit === "N" ? 1 : 2;
}

function size(body) {
  return { width: Math.max(120, Math.floor(body.clientWidth)), height: Math.max(70, Math.floor(body.clientHeight)) };
}

function figure(parent, trace) {
  const make = (tag, name, text = "") => Object.assign(document.createElement(tag), { className: name, textContent: text });
  const whole = make("figure", "trace"), head = make("figcaption", "trace-head"), body = make("div", "trace-body");
  head.append(make("span", "trace-title", `${trace.title} (${trace.unit})`));
  const values = trace.series.map((series) => {
    const item = make("span", "trace-value");
    const swatch = make("span", `swatch line ${series.color}${series.dash ? " dashed" : ""}`);
    const value = make("span", "number", "");
    item.append(swatch, make("span", "", `${series.name} `), value);
    head.append(item);
    return value;
  });
  if (trace.hasYield) {
    const item = make("span", "trace-value yield-key");
    item.append(make("span", "swatch line yield dashed"), make("span", "", "yield force R"));
    head.append(item);
  }
  body.setAttribute("role", "img");
  body.setAttribute("aria-label", `Trace over time: ${trace.title} in ${trace.unit}`);
  whole.append(head, body);
  parent.append(whole);
  return { figure: whole, body, values };
}

function yieldLine(plot, yield_n, color) {
  const { ctx, bbox } = plot;
  const y = Math.round(plot.valToPos(yield_n, "y", true)) + 0.5;
  ctx.save();
  ctx.strokeStyle = color;
  ctx.lineWidth = devicePixelRatio;
  ctx.setLineDash([6 * devicePixelRatio, 4 * devicePixelRatio]);
  ctx.beginPath();
  ctx.moveTo(bbox.left, y);
  ctx.lineTo(bbox.left + bbox.width, y);
  ctx.stroke();
  ctx.restore();
}

function exported(pen, box, { trace, data, range, window }, charts, time) {
  const { colors } = charts;
  const frame = { left: box.x + LEFT, right: box.x + box.width - 8, top: box.y + 20, bottom: box.y + box.height - 18 };
  const toX = (value) => frame.left + ((value - window[0]) / (window[1] - window[0])) * (frame.right - frame.left);
  const toY = (value) => frame.bottom - ((value - range[0]) / (range[1] - range[0])) * (frame.bottom - frame.top);
  pen.text(frame.left, box.y + 12, `${trace.title} (${trace.unit})`, { color: colors.ink, size: 13, weight: 600 });
  for (const value of ticks(range, 4)) {
    pen.line([frame.left, toY(value), frame.right, toY(value)], { color: colors.grid });
    pen.text(frame.left - 6, toY(value) + 4, label(value), { color: colors.muted, size: 11, anchor: "end" });
  }
  for (const value of ticks(window, 6)) pen.text(toX(value), frame.bottom + 15, label(value), { color: colors.muted, size: 11, anchor: "middle" });
  pen.within(frame.left, frame.top, frame.right - frame.left, frame.bottom - frame.top, (inner) => {
    data.slice(1).forEach((values, k) => {
      const isOther = k >= trace.series.length, series = trace.series[k % trace.series.length];
      const flat = [];
      values.forEach((value, at) => {
        if (value === undefined) return;
        flat.push(toX(data[0][at]) - frame.left, value === null ? NaN : toY(value) - frame.top);
      });
      inner.line(flat, { color: isOther ? colors.other : colors[series.color], width: isOther ? 1.2 : 1.6, dash: isOther ? [3, 3] : series.dash ?? [] });
    });
    for (const [yield_n, color] of trace.hasYield ? charts.yieldLines() : []) {
      inner.line([0, toY(yield_n) - frame.top, frame.right - frame.left, toY(yield_n) - frame.top], { color, dash: [6, 4] });
    }
    if (time >= window[0] && time <= window[1]) inner.line([toX(time) - frame.left, 0, toX(time) - frame.left, frame.bottom - frame.top], { color: colors.ink, width: 1.5 });
  });
}

function ticks([low, high], about) {
  const rough = (high - low) / about;
  if (!(rough > 0)) return [];
  const power = 10 ** Math.floor(Math.log10(rough)), step = power * [1, 2, 5, 10].find((digit) => digit * power >= rough);
  const all = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + step * 1e-6; k += 1) all.push(k * step);
  return all;
}
