// Elements, colours, and charts of curves. Text goes in as text, never as HTML.

function element(name, attributes = {}, ...children) {
  const found = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) found.addEventListener(key.slice(2), value);
    else if (key in found && key !== "list") found[key] = value;
    else found.setAttribute(key, value);
  }
  found.append(...children);
  return found;
}

function choice(label, options, value, changed) {
  const select = element("select", { onchange: () => changed(select.value) });
  for (const [key, text] of options) select.append(element("option", { value: key, textContent: text }));
  select.value = value;
  const found = element("label", { className: "choice" }, `${label} `, select);
  found.select = select;
  return found;
}

const dark = matchMedia("(prefers-color-scheme: dark)");

// A browser that prints is light for that moment, and would take pictures half drawn: they are printed as they stand.
const recoloured = (work) => dark.addEventListener("change", () => matchMedia("print").matches || work());

function ink() {
  const style = getComputedStyle(document.documentElement), read = (name) => style.getPropertyValue(name).trim();
  return {
    text: read("--text"), soft: read("--soft"), line: read("--line"), page: read("--page"), bad: read("--bad"),
    accent: read("--accent"), dead: read("--dead"), series: [0, 1, 2, 3, 4, 5, 6, 7].map((i) => read(`--series-${i}`)),
  };
}

// Viridis at nine points, straight lines between.
const STOPS = [
  [68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141],
  [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37],
];
const RAMP = Array.from({ length: 256 }, (_, i) => {
  const at = (i / 255) * 8, k = Math.min(7, Math.floor(at)), share = at - k;
  return STOPS[k].map((from, c) => Math.round(from + share * (STOPS[k + 1][c] - from)));
});
const rgb = ([r, g, b]) => `rgb(${r},${g},${b})`;

// A number on an axis or in a hint.
function short(value) {
  if (value === 0) return "0";
  const size = Math.abs(value);
  return size >= 1e5 || size < 1e-3 ? value.toExponential(1).replace(".0e", "e").replace("e+", "e") : String(Number(value.toPrecision(3)));
}

const drawn = new Map(); // element → { chart, draw }

// An ECharts canvas in an element, drawn again where the size or the colours change.
function surface(box, draw) {
  const chart = echarts.init(box, null, { renderer: "canvas" });
  // The box, not the window: it also narrows when a view is put beside it.
  const sizes = new ResizeObserver(() => chart.resize());
  const entry = { chart, sizes, draw: () => chart.setOption(base(draw(ink())), { notMerge: true }) };
  drawn.set(box, entry);
  entry.draw();
  sizes.observe(box);
  return entry;
}

function discard(holder) {
  for (const [box, entry] of drawn) {
    if (!holder.contains(box)) continue;
    entry.sizes.disconnect();
    entry.chart.dispose();
    drawn.delete(box);
  }
  holder.replaceChildren();
}

recoloured(() => drawn.forEach((entry) => entry.draw()));

function base(option) {
  return {
    animation: false,
    backgroundColor: ink().page, // of the picture itself: it may be printed on another
    textStyle: { fontFamily: "system-ui, sans-serif", color: ink().text },
    ...option,
    // Hints drawn in the canvas: no HTML is ever made of a name.
    tooltip: {
      renderMode: "richText", confine: true, backgroundColor: ink().page, borderColor: ink().line,
      textStyle: { color: ink().text, fontSize: 12 }, ...option.tooltip,
    },
  };
}

// `log` may be how often the least value goes into the largest: few decades want powers of two.
function axis(colors, label, log, more = {}) {
  return {
    type: log ? "log" : "value", logBase: log > 0 && log < 100 ? 2 : 10, name: label, nameLocation: "middle", scale: true,
    nameTextStyle: { color: colors.soft, fontSize: 12 },
    axisLine: { show: true, lineStyle: { color: colors.line } }, axisTick: { show: false },
    axisLabel: { color: colors.soft, fontSize: 11, formatter: short, hideOverlap: true },
    splitLine: { lineStyle: { color: colors.line, opacity: 0.5 } }, ...more,
  };
}

// Lines that a legend takes, by how long its names are.
function legendLines(names, width) {
  let lines = 1, place = 0;
  for (const name of names) {
    const size = 34 + 6.3 * name.length;
    if (place + size > width && place > 0) [lines, place] = [lines + 1, 0];
    place += size;
  }
  return lines;
}

function curveOption(chart, colors, width) {
  const bars = chart.series.some((each) => each.style === "bars");
  const position = (x, y) => [x, y].map((value) => (value === null || value === undefined ? NaN : value));
  const series = chart.series.map((each) => {
    const color = colors.series[each.color % colors.series.length];
    const logged = (value, log) => (log && !(value > 0) ? null : value);
    const data = each.style === "bars" ? each.y : each.x.map((x, i) => [logged(x, chart.xLog), logged(each.y[i], chart.yLog)]);
    if (each.style === "bars") return { type: "bar", name: each.name, data, itemStyle: { color } };
    if (each.style === "dots") return { type: "scatter", name: each.name, data, symbolSize: 6, itemStyle: bars ? { color: colors.page, borderColor: color, borderWidth: 1.5 } : { color }, xAxisIndex: bars ? 1 : 0 };
    return {
      type: "line", name: each.name, data, showSymbol: false, itemStyle: { color },
      lineStyle: { color, width: 1.5, type: each.style === "dash" ? "dashed" : "solid" },
    };
  });
  const lines = chart.marks.filter((mark) => (mark.x === null) !== (mark.y === null));
  const points = chart.marks.filter((mark) => mark.x !== null && mark.y !== null);
  if (series.length && lines.length) {
    series[0].markLine = {
      symbol: "none", silent: true, lineStyle: { color: colors.bad, type: "dashed" },
      data: lines.map((mark) => ({
        ...(mark.x === null ? { yAxis: mark.y } : { xAxis: mark.x }),
        label: { formatter: mark.text, color: colors.bad, position: "insideEndTop", fontSize: 11 },
      })),
    };
  }
  if (points.length) {
    series.push({
      type: "scatter", silent: true, symbolSize: 6, data: points.map((mark) => position(mark.x, mark.y)),
      itemStyle: { color: colors.bad },
      label: {
        show: true, position: "right", color: colors.soft, fontSize: 10,
        formatter: ({ dataIndex }) => points[dataIndex].text,
      },
      labelLayout: { hideOverlap: true },
    });
  }
  const span = (log, range, name) => {
    if (!log) return false;
    const values = range || chart.series.flatMap((each) => each[name]).filter((value) => value > 0);
    return values.reduce((a, b) => Math.max(a, b), 0) / values.reduce((a, b) => Math.min(a, b), Infinity) || true;
  };
  const ends = (range) => (range ? { min: range[0], max: range[1] } : {});
  const named = chart.series.filter((each) => each.name), lower = 18 * (legendLines(named.map((each) => each.name), width - 16) - 1);
  const categories = bars && { type: "category", data: chart.categories, name: chart.x, nameLocation: "middle", nameGap: 28,
    nameTextStyle: { color: colors.soft }, axisLabel: { color: colors.soft, fontSize: 11, interval: 0, hideOverlap: true },
    axisLine: { lineStyle: { color: colors.line } } };
  // Dots stand on their own bar, a fraction of a category beside its middle.
  const between = bars && { type: "value", show: false, min: -0.5, max: chart.categories.length - 0.5, axisPointer: { show: false, triggerTooltip: false } };
  return {
    title: { text: chart.title, left: 8, top: 4, textStyle: { fontSize: 13, fontWeight: 600, color: colors.text } },
    grid: { left: 62, right: 18, top: named.length ? 58 + lower : 36, bottom: 44 },
    legend: { show: named.length > 0, top: 26, left: 8, right: 8, itemGap: 8, itemHeight: 8, itemWidth: 18,
      textStyle: { color: colors.soft, fontSize: 11 }, data: named.map((each) => each.name) },
    tooltip: { trigger: bars || !chart.square ? "axis" : "item", valueFormatter: (value) => (value === null ? "–" : short(value)) },
    xAxis: bars
      ? [categories, between]
      : axis(colors, chart.x, span(chart.xLog, chart.xRange, "x"), { nameGap: 26, ...ends(chart.xRange) }),
    yAxis: axis(colors, chart.y, span(chart.yLog, chart.yRange, "y"), { nameGap: 46, scale: !bars, ...ends(chart.yRange), axisLine: { show: true, onZero: !bars, lineStyle: { color: colors.line } } }),
    dataZoom: [{ type: "inside", xAxisIndex: bars ? [0, 1] : 0, zoomOnMouseWheel: "ctrl", moveOnMouseWheel: false, filterMode: "none" }],
    series,
  };
}

// Curves as people expect them; said in words too, for those who do not see them.
function curveChart(box, chart) {
  box.setAttribute("role", "img");
  box.setAttribute("aria-label", `${chart.title}: ${chart.y} over ${chart.x}`);
  box.classList.toggle("square", chart.square);
  surface(box, (colors) => curveOption(chart, colors, box.clientWidth || 400));
}

const hand = { down: false }; // whether somebody is dragging a brush

// What takes longer than a frame waits until the hand rests.
function later(work, wait = 120) {
  let timer = 0;
  const due = () => {
    if (hand.down) timer = setTimeout(due, wait);
    else work();
  };
  return () => {
    clearTimeout(timer);
    timer = setTimeout(due, wait);
  };
}
