// Live plots from the websocket /feed (its layout stands at the top of feed.py), drawn by uPlot.
const DRAW_MS = 66;
const KEPT_S = 61;
const STALE_MS = 1500;
const GAP_S = 0.5; // a longer step is no line
const DASHES = { x: [], y: [10, 4], z: [2, 3] };
const LEAST_SPAN = { "deg/s": 1, "m/s²": 0.5, deg: 2, "°C": 0.5, count: 10 };

function load(url) {
  return new Promise((resolve, reject) => {
    const css = url.endsWith(".css");
    const known = document.querySelector(`[data-panel="${url}"]`);
    if (known && known.dataset.loaded) return resolve();
    const element = known || document.createElement(css ? "link" : "script");
    element.addEventListener("load", () => { element.dataset.loaded = "yes"; resolve(); });
    element.addEventListener("error", reject);
    if (known) return;
    element.dataset.panel = url;
    if (css) Object.assign(element, { rel: "stylesheet", href: url });
    else element.src = url;
    document.head.append(element);
  });
}

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

function look(line) {
  const axis = /^(raw|corrected) ([xyz])$/.exec(line.name);
  return {
    colour: axis ? `--panel-${axis[2]}` : "--panel-ink",
    dash: axis ? DASHES[axis[2]] : [],
    width: axis && axis[1] === "raw" ? 1 : 1.75,
    scale: line.unit,
  };
}

function shown(value, unit) {
  if (value === null || value === undefined) return "unknown";
  const text = value.toFixed(unit === "count" ? 0 : unit === "v" ? 4 : Math.abs(value) < 100 ? 2 : 1);
  return text.replace(/^-(0(\.0*)?)$/, "$1"); // no minus before nothing
}

// Least and greatest of an axis, on steps wide enough that noise does not make it tremble.
function range(unit, least, most, centred) {
  if (least === null || most === null || !isFinite(least) || !isFinite(most)) return [0, 1];
  if (centred) most = Math.max(Math.abs(least), Math.abs(most)), least = -most;
  const span = Math.max(most - least, LEAST_SPAN[unit] || 1e-3), middle = (least + most) / 2;
  const step = 10 ** Math.floor(Math.log10(span)) / 2;
  return [Math.floor((middle - span * 0.55) / step) * step, Math.ceil((middle + span * 0.55) / step) * step];
}

export default {
  template: '<div class="panel"></div>',
  props: { plots: Array, span: Number, spans: Array, resourcePath: String },
  async mounted() {
    this.time = [];
    this.columns = [];
    this.charts = [];
    this.seconds = this.span;
    this.paused = this.gone = false;
    this.frame = -1;
    this.heard = 0;
    this.retry = 1000;
    this.head = null;
    this.build();
    const base = (window.path_prefix || "") + this.resourcePath;
    await Promise.all(["/uplot/uPlot.min.css", "/panel.css", "/uplot/uPlot.iife.min.js"].map((file) => load(base + file)));
    if (this.gone) return;
    this.motion = matchMedia("(prefers-reduced-motion: reduce)");
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.repaint = () => this.arrange();
    this.dark.addEventListener("change", this.repaint);
    this.resizer = new ResizeObserver(() => this.fit());
    this.resizer.observe(this.body);
    this.connect();
    this.words = setInterval(() => this.tell(), 1000);
    this.next();
  },
  unmounted() {
    this.gone = true;
    clearInterval(this.words);
    clearTimeout(this.drawing);
    clearTimeout(this.again);
    if (this.socket) this.socket.close();
    if (this.resizer) this.resizer.disconnect();
    if (this.dark) this.dark.removeEventListener("change", this.repaint);
    for (const chart of this.charts) chart.plot.destroy();
  },
  methods: {
    build() {
      this.pause = make("button", { type: "button", "aria-pressed": "false" }, "Pause");
      this.pause.addEventListener("click", () => this.setPaused(!this.paused));
      const group = make("div", { role: "group", "aria-label": "Time shown", class: "panel-spans" });
      for (const seconds of this.spans) {
        const button = make("button", { type: "button", "aria-pressed": String(seconds === this.seconds) }, `${seconds} s`);
        button.addEventListener("click", () => {
          this.seconds = seconds;
          for (const other of group.children) other.setAttribute("aria-pressed", String(other === button));
          this.draw();
        });
        group.append(button);
      }
      this.state = make("span", { role: "status", class: "panel-state" }, "Connecting");
      this.body = make("div", { class: "panel-body" });
      this.$el.append(make("div", { class: "panel-bar" }, this.pause, group, this.state), this.body);
    },
    setPaused(paused) {
      this.paused = paused;
      this.pause.textContent = paused ? "Resume" : "Pause";
      this.pause.setAttribute("aria-pressed", String(paused));
      this.tell();
    },
    connect() {
      const scheme = location.protocol === "https:" ? "wss" : "ws";
      this.socket = new WebSocket(`${scheme}://${location.host}${window.path_prefix || ""}/feed?plots=${this.plots.join(",")}`);
      this.socket.binaryType = "arraybuffer";
      this.socket.onmessage = ({ data }) => {
        this.retry = 1000;
        if (typeof data === "string") this.begin(JSON.parse(data));
        else this.take(data);
      };
      this.socket.onclose = () => {
        if (this.gone) return;
        this.head = null;
        this.tell();
        this.again = setTimeout(() => this.connect(), this.retry);
        this.retry = Math.min(2 * this.retry, 5000);
      };
    },
    begin(head) {
      this.head = head;
      this.time = [];
      this.columns = head.plots.flatMap((plot) => plot.lines.map(() => []));
      this.frame = -1;
      this.heard = 0;
      this.arrange();
      this.tell();
    },
    take(buffer) {
      const view = new DataView(buffer);
      if (view.getUint32(0) !== 0x55444631 || view.getUint16(6, true) !== this.columns.length) return;
      const envelope = view.getUint8(4) === 1, number = view.getUint32(8, true), rows = view.getUint32(12, true);
      const start = view.getFloat64(16, true), held = new Float32Array(buffer, 24);
      const last = this.time[this.time.length - 1];
      const missed = (this.frame >= 0 && number !== this.frame + 1) || start - last > GAP_S;
      this.frame = number;
      this.heard = performance.now();
      if (missed && this.time.length) { // what did not arrive is a gap, not a line
        this.time.push(last + 1e-6);
        for (const column of this.columns) column.push(null);
      }
      const half = envelope && rows > 1 ? (held[1] - held[0]) / 2 : 0;
      for (let row = 0; row < rows; row++) {
        this.time.push(start + held[row]);
        if (envelope) this.time.push(start + held[row] + half);
      }
      this.columns.forEach((column, k) => {
        const least = rows * (1 + k), most = rows * (1 + this.columns.length + k);
        for (let row = 0; row < rows; row++) {
          const value = held[least + row];
          column.push(Number.isNaN(value) ? null : value);
          if (envelope) column.push(Number.isNaN(held[most + row]) ? null : held[most + row]);
        }
      });
      const old = this.place(this.time[this.time.length - 1] - KEPT_S);
      if (old > 1000) {
        this.time.splice(0, old);
        for (const column of this.columns) column.splice(0, old);
      }
    },
    // The first row at or after a time.
    place(time) {
      let low = 0, high = this.time.length;
      while (low < high) {
        const middle = (low + high) >> 1;
        if (this.time[middle] < time) low = middle + 1;
        else high = middle;
      }
      return low;
    },
    // Make the plots of a head anew.
    arrange() {
      for (const chart of this.charts) chart.plot.destroy();
      this.charts = [];
      this.body.replaceChildren();
      let column = 0;
      for (const plot of this.head ? this.head.plots : []) {
        if (plot.lines.length) this.charts.push(this.chart(plot, column));
        column += plot.lines.length;
      }
      this.draw();
      this.tell();
    },
    chart(plot, first) {
      const css = getComputedStyle(this.$el), colour = (name) => css.getPropertyValue(name).trim();
      const units = [...new Set(plot.lines.map((line) => line.unit))];
      const two = units.length > 1; // their zeros stand at one height
      const name = (unit) => (two ? `${plot.lines.find((line) => line.unit === unit).name.split(" ")[0]}, ${unit}` : unit);
      const picture = make("div", { role: "img", class: "panel-plot", "aria-label": plot.title });
      const legend = make("ul", { class: "panel-legend", "aria-label": `Lines of ${plot.title}` });
      const title = make("h3", {}, two ? plot.title : `${plot.title}, ${units[0]}`);
      this.body.append(make("section", { class: "panel-chart", "aria-label": plot.title }, title, picture, legend));
      const axis = { stroke: colour("--panel-ink"), font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif" };
      const grid = { stroke: colour("--panel-line"), width: 1 };
      const axes = units.map((unit, k) => ({
        ...axis, scale: unit, label: name(unit), labelSize: 18, size: 52, side: k ? 1 : 3, grid: k ? { show: false } : grid, ticks: grid,
      }));
      const time = { ...axis, label: "Time before now, s", labelSize: 18, size: 32, grid, ticks: grid };
      const scales = Object.fromEntries(units.map((unit) => [unit, { range: (_, least, most) => range(unit, least, most, two) }]));
      const options = {
        width: Math.max(this.body.clientWidth, 120),
        height: this.height(),
        legend: { show: false },
        cursor: { show: false },
        scales: { x: { time: false, auto: false, range: () => [-this.seconds, 0] }, ...scales },
        axes: [{ ...time, values: (_, splits) => splits.map((t) => Math.abs(t)) }, ...axes],
        series: [{}],
      };
      const values = plot.lines.map((line, k) => {
        const { colour: shade, dash, width, scale } = look(line);
        options.series.push({ stroke: colour(shade), dash, width, scale, points: { show: false } });
        return this.entry(legend, line, { colour: shade, dash, width }, k);
      });
      const made = { plot: new uPlot(options, [[], ...plot.lines.map(() => [])], picture), first, values, picture, title: plot.title };
      made.lines = plot.lines;
      legend.addEventListener("click", (event) => {
        const button = event.target.closest("button");
        if (!button) return;
        const show = button.getAttribute("aria-pressed") !== "true";
        button.setAttribute("aria-pressed", String(show));
        made.plot.setSeries(Number(button.dataset.line) + 1, { show });
      });
      return made;
    },
    entry(legend, line, { colour, dash, width }, k) {
      const sample = `<svg width="28" height="10" aria-hidden="true"><line x1="0" y1="5" x2="28" y2="5"
        style="stroke: var(${colour}); stroke-width: ${width}; stroke-dasharray: ${dash.join(" ") || "none"}"/></svg>`;
      const value = make("b");
      const button = make("button", { type: "button", "aria-pressed": "true", "data-line": k });
      button.innerHTML = sample;
      button.append(`${line.name} `, value, make("span", { class: "panel-unit" }, ` ${line.unit}`));
      legend.append(make("li", {}, button));
      return value;
    },
    height() {
      return innerWidth < 480 ? 170 : 220;
    },
    fit() {
      const width = Math.max(this.body.clientWidth, 120);
      for (const { plot } of this.charts) if (plot.width !== width) plot.setSize({ width, height: this.height() });
    },
    // Draw again and again: fifteen times a second, or once where less motion is wanted.
    next() {
      this.drawing = setTimeout(() => requestAnimationFrame(() => {
        if (this.gone) return;
        if (!this.paused && this.heard !== this.drawn) this.draw();
        this.next();
      }), this.motion.matches ? 1000 : DRAW_MS);
    },
    draw() {
      this.drawn = this.heard;
      if (!this.time.length) return;
      const newest = this.time[this.time.length - 1], start = this.place(newest - this.seconds);
      const time = this.time.slice(start).map((t) => t - newest);
      for (const { plot, first, lines } of this.charts) {
        plot.setData([time, ...lines.map((_, k) => this.columns[first + k].slice(start))]);
      }
    },
    // Once a second the newest values in words: beside the legend, and for screen readers.
    tell() {
      const silent = performance.now() - this.heard > STALE_MS;
      let state = "";
      if (!this.head) state = "Connection to the bench lost. Trying again.";
      else if (!this.head.source) state = "No device connected.";
      else if (!this.heard) state = "Waiting for readings.";
      else if (this.paused) state = "Paused.";
      else state = silent ? "No new readings." : "Live.";
      if (this.state.textContent !== state) this.state.textContent = state;
      if (this.paused) return;
      for (const { first, lines, values, picture, title } of this.charts) {
        const words = lines.map((line, k) => {
          const column = this.columns[first + k], text = shown(column[column.length - 1], line.unit);
          values[k].textContent = text;
          return `${line.name} ${text} ${line.unit}`;
        });
        picture.setAttribute("aria-label", `${title} over the last ${this.seconds} s. Now: ${words.join(", ")}. ${state}`.trim());
      }
    },
  },
};
