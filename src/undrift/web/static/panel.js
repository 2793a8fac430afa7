// The trace of a recording (frames are described at the top of panel.py), drawn by uPlot.
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

const height = () => innerWidth < 480 ? 170 : 220;

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

function look(line) {
  const axis = line.name.at(-1);
  return { colour: `--panel-${axis}`, dash: DASHES[axis], width: 1, scale: line.unit };
}

function shown(value, unit) {
  if (value === null || value === undefined) return "unknown";
  const text = value.toFixed(unit === "count" ? 0 : unit === "v" ? 4 : Math.abs(value) < 100 ? 2 : 1);
  return text.replace(/^-(0(\.0*)?)$/, "$1"); // no minus before nothing
}

// Least and greatest of an axis, on steps wide enough that noise does not make it tremble.
function range(unit, least, most) {
  if (least === null || most === null || !isFinite(least) || !isFinite(most)) return [0, 1];
  const span = Math.max(most - least, LEAST_SPAN[unit] || 1e-3), middle = (least + most) / 2;
  const step = 10 ** Math.floor(Math.log10(span)) / 2;
  return [Math.floor((middle - span * 0.55) / step) * step, Math.ceil((middle + span * 0.55) / step) * step];
}

export default {
  template: '<div class="panel"></div>',
  props: { resourcePath: String, trace: Object },
  async mounted() {
    this.time = [];
    this.columns = [];
    this.charts = [];
    this.plots = [];
    this.gone = false;
    this.build();
    const base = (window.path_prefix || "") + this.resourcePath;
    await Promise.all(["/uplot/uPlot.min.css", "/panel.css", "/uplot/uPlot.iife.min.js"].map((file) => load(base + file)));
    if (this.gone) return;
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.repaint = () => this.arrange();
    this.dark.addEventListener("change", this.repaint);
    this.resizer = new ResizeObserver(() => this.fit());
    this.resizer.observe(this.body);
    this.showAll();
  },
  unmounted() {
    this.gone = true;
    cancelAnimationFrame(this.playing);
    if (this.resizer) this.resizer.disconnect();
    if (this.dark) this.dark.removeEventListener("change", this.repaint);
    for (const chart of this.charts) chart.plot.destroy();
  },
  methods: {
    take(buffer) {
      const view = new DataView(buffer);
      if (view.getUint32(0) !== 0x55444631 || view.getUint16(6, true) !== this.columns.length) return;
      const envelope = view.getUint8(4) === 1, rows = view.getUint32(12, true);
      const start = view.getFloat64(16, true), held = new Float32Array(buffer, 24);
      const blocks = envelope ? 2 : 1, half = rows > 1 ? (held[1] - held[0]) / 2 : 0; // the least ones, then the greatest
      for (let row = 0; row < rows; row++) for (let block = 0; block < blocks; block++) {
        this.time.push(start + held[row] + block * half);
        this.columns.forEach((column, k) => {
          const value = held[rows * (1 + k + block * this.columns.length) + row];
          column.push(Number.isNaN(value) ? null : value);
        });
      }
    },
    // Make the plots again.
    arrange() {
      for (const chart of this.charts) chart.plot.destroy();
      this.charts = [];
      this.body.replaceChildren();
      let column = 0;
      for (const plot of this.plots) {
        if (plot.key === "pose") this.pose = column;
        else if (plot.lines.length && plot.lines[0].unit) this.charts.push(this.chart(plot, column));
        column += plot.lines.length;
      }
      this.draw();
    },
    chart(plot, first) {
      const css = getComputedStyle(this.$el), colour = (name) => css.getPropertyValue(name).trim();
      const unit = plot.lines[0].unit;
      const picture = make("div", { role: "img", class: "panel-plot", "aria-label": plot.title });
      const legend = make("ul", { class: "panel-legend", "aria-label": `Lines of ${plot.title}` });
      const title = make("h3", {}, `${plot.title}, ${unit}`);
      this.body.append(make("section", { class: "panel-chart", "aria-label": plot.title }, title, picture, legend));
      const axis = { stroke: colour("--panel-ink"), font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif" };
      const grid = { stroke: colour("--panel-line"), width: 1 };
      const values_axis = { ...axis, scale: unit, label: unit, labelSize: 18, size: 52, side: 3, grid, ticks: grid };
      const time = { ...axis, label: "Time, s", labelSize: 18, size: 32, grid, ticks: grid };
      const options = {
        width: Math.max(this.body.clientWidth, 120),
        height: height(),
        legend: { show: false },
        cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false }, sync: { key: this.trace.url } },
        hooks: { drawClear: [(drawn) => this.bands(drawn)], setSelect: [(drawn) => this.take_stretch(drawn)], setCursor: [(drawn) => this.point(drawn)], ready: [(drawn) => this.touch(drawn)] },
        scales: { x: { time: false, auto: false, range: () => [this.from, this.to] }, [unit]: { range: (_, least, most) => range(unit, least, most) } },
        axes: [time, values_axis],
        series: [{}],
      };
      const values = plot.lines.map((line, k) => {
        const { colour: shade, dash, width, scale } = look(line);
        options.series.push({ stroke: colour(shade), dash, width, scale, points: { show: false } });
        return this.entry(legend, line, { colour: shade, dash, width }, k);
      });
      const made = { plot: new uPlot(options, [[], ...plot.lines.map(() => [])], picture), first, values, picture, title: plot.title, lines: plot.lines };
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
    fit() {
      const width = Math.max(this.body.clientWidth, 120);
      for (const { plot } of this.charts) if (plot.width !== width) plot.setSize({ width, height: height() });
    },
    draw() {
      if (!this.time.length) return;
      for (const { plot, first, lines } of this.charts) plot.setData([this.time, ...lines.map((_, k) => this.columns[first + k])]);
    },
    // ---- A recording as a whole: zoomed, with its stretches, and the device as it lay

    build() {
      const button = (words, act) => { const made = make("button", { type: "button" }, words); made.addEventListener("click", act); return made; };
      const field = (words) => { const input = make("input", { type: "number", step: "any" }); return [make("label", { class: "bench-field" }, make("span", {}, words), input), input]; };
      const [startLabel, start] = field("Stretch from, s"), [stopLabel, stop] = field("to, s");
      this.ends = [start, stop];
      const zoom = (factor, shift = 0) => { const [middle, half] = [(this.from + this.to) / 2 + shift * (this.to - this.from), (this.to - this.from) / 2 * factor]; this.show(middle - half, middle + half); };
      const chosen = (act) => () => { const [a, b] = this.ends.map((each) => each.valueAsNumber); if (a < b) act(a, b); else start.focus(); };
      const send = (kind) => chosen((a, b) => this.$emit("stretch", { kind, start: a, stop: b }));
      this.state = make("span", { role: "status", class: "panel-state" });
      this.body = make("div", { class: "panel-body" });
      this.play = button("Play", () => this.run());
      this.lying = make("undrift-drawing", { kind: "body", class: "panel-lying" });
      const view = make("div", { role: "group", "aria-label": "View", class: "panel-bar" }, button("Zoom in", () => zoom(0.5)), button("Zoom out", () => zoom(2)),
        button("Earlier", () => zoom(1, -0.5)), button("Later", () => zoom(1, 0.5)), button("Show all", () => this.showAll()), this.state);
      const stretch = make("div", { role: "group", "aria-label": "Stretch", class: "panel-bar" }, startLabel, stopLabel, button("Zoom to it", chosen((a, b) => this.show(a, b))),
        button("Leave it out", send("leave")), button("Use it alone", send("alone")));
      this.device = make("section", { "aria-label": "Device as it lay", class: "panel-device", hidden: "" }, this.lying, make("div", {}, make("h3", {}, "Wrong axes?"),
        make("p", {}, "Hold the device as it lay and turn it as you did, while the drawing does: play the trace, or point at it."), make("p", { class: "soft" }, this.trace.lying), this.play));
      this.$el.append(view, this.body, ...(this.trace.chosen ? [stretch] : []), this.device);
    },
    showAll() { this.show(0, this.trace.length); },
    // Show from one time to another, by as many rows as there are pixels.
    async show(from, to) {
      const span = Math.min(Math.max(to - from, 1e-2), this.trace.length);
      this.from = Math.min(Math.max(from, 0), this.trace.length - span);
      this.to = this.from + span;
      const asked = this.asked = {}, rows = Math.max(this.body.clientWidth, 120), url = `${this.trace.url}?start=${this.from}&stop=${this.to}&rows=${rows}`;
      const answer = await fetch(url).catch(() => null);
      if (this.gone || asked !== this.asked) return;
      if (!answer || !answer.ok) return void (this.state.textContent = "The readings did not come: load the page again.");
      const buffer = await answer.arrayBuffer();
      if (this.gone || asked !== this.asked) return;
      const plot = (key, title, axes, unit) => ({ key, title, lines: [...axes].map((axis) => ({ name: `raw ${axis}`, unit })) }), { gyro, accel } = this.trace.units;
      if (!this.plots.length) {
        this.plots = [plot("rate", "Turn rate", "xyz", gyro), plot("accel", "Specific force", "xyz", accel), plot("pose", "", "wxyz")];
        this.columns = this.plots.flatMap(({ lines }) => lines);
        this.arrange();
      }
      this.time = [];
      this.columns = this.columns.map(() => []);
      this.take(buffer);
      this.draw();
      const words = `${this.from.toFixed(2)} to ${this.to.toFixed(2)} s`, counts = this.trace.words;
      this.state.textContent = `${words}. ${counts}`;
      for (const { picture, title, plot } of this.charts) picture.setAttribute("aria-label", `${title}, ${words}. ${counts}`), plot.setSelect({ width: 0 }, false);
      if (this.pose !== undefined && !this.lying.innerHTML) this.lie(this.columns[this.pose].findIndex((w) => w !== null));
    },
    // Rests, turns and what was no rest, behind the lines.
    bands(plot) {
      const { ctx, bbox } = plot, css = getComputedStyle(this.$el);
      ctx.save();
      Object.assign(ctx, { textAlign: "left", textBaseline: "alphabetic" });
      ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
      for (const [kind, label, why, start, stop] of this.trace.stretches) {
        const [x0, x1] = [start, stop].map((time) => Math.min(Math.max(plot.valToPos(time, "x", true), bbox.left), bbox.left + bbox.width));
        if (x1 - x0 < 0.5) continue;
        const colour = css.getPropertyValue(why ? "--soft" : kind === "turn" ? "--panel-y" : "--good").trim(), words = why ? "" : kind === "turn" ? `turn ${label}` : label || "rest";
        ctx.fillStyle = colour;
        ctx.globalAlpha = 0.14;
        ctx.fillRect(x0, bbox.top, x1 - x0, bbox.height);
        ctx.globalAlpha = 1;
        if (!why) ctx.fillRect(x0, kind === "turn" ? bbox.top + bbox.height - 4 : bbox.top, x1 - x0, 4);
        if (ctx.measureText(words).width < x1 - x0 - 4) ctx.fillText(words, x0 + 3, kind === "turn" ? bbox.top + bbox.height - 9 : bbox.top + 15 * devicePixelRatio);
      }
      ctx.restore();
    },
    // uPlot hears a mouse alone: a finger that moves sideways is one; up and down it scrolls the page.
    touch({ over }) {
      for (const [name, mouse] of Object.entries({ pointerdown: "mousedown", pointermove: "mousemove", pointerup: "mouseup", pointercancel: "mouseup" })) over.addEventListener(name, (event) => {
        if (event.pointerType !== "mouse") over.dispatchEvent(new MouseEvent(mouse, { bubbles: true, clientX: event.clientX, clientY: event.clientY, movementX: 1 }));
      });
    },
    take_stretch({ select, posToVal }) {
      if (select.width > 2) [select.left, select.left + select.width].forEach((at, k) => { this.ends[k].value = posToVal(at, "x").toFixed(2); });
    },
    point({ cursor }) {
      const row = cursor.idx;
      if (row === null || row === undefined || cursor.left < 0) return;
      this.lie(row);
      for (const { first, lines, values } of this.charts) lines.forEach((line, k) => { values[k].textContent = shown(this.columns[first + k][row], line.unit); });
    },
    // The device as it lay at a row; nothing is drawn where that is not known.
    lie(row) {
      const q = this.pose === undefined ? [null] : [0, 1, 2, 3].map((k) => this.columns[this.pose + k][row]);
      const known = q.every((part) => part !== null && part !== undefined);
      this.lying.style.visibility = known ? "" : "hidden";
      if (!known) return;
      this.lying.setAttribute("what", JSON.stringify(q));
      this.device.hidden = false;
    },
    // Turn the device through what is shown, in real time or in 20 s.
    run() {
      const stop = this.play.textContent === "Stop", speed = Math.max(1, (this.to - this.from) / 20), began = performance.now();
      cancelAnimationFrame(this.playing);
      this.play.textContent = stop ? "Play" : "Stop";
      const step = () => {
        const time = this.from + (performance.now() - began) / 1000 * speed, { plot } = this.charts[0];
        if (this.gone || time >= this.to) return void (this.play.textContent = "Play");
        plot.setCursor({ left: plot.valToPos(time, "x"), top: 10 });
        this.playing = requestAnimationFrame(step);
      };
      if (!stop) step();
    },
  },
};
