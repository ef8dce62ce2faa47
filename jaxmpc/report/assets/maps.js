// Maps over parameters and tissues: the best of each cell, and which share of it is stable; importance.

const MOST_CELLS = 24, LEAST_ROWS = 8; // fewer rows make no map

// Cells of a parameter: its values where they are few, else stretches of its range.
function cellsOf(each) {
  const values = each.columns[0], points = [...new Set(values)].filter(Number.isFinite).sort((a, b) => a - b);
  if (points.length <= 2 * MOST_CELLS) {
    const at = new Map(points.map((point, i) => [point, i]));
    return { names: points.map(short), of: Int16Array.from(values, (value) => at.get(value) ?? -1) };
  }
  const count = Math.max(4, Math.min(MOST_CELLS, Math.round(Math.sqrt(values.length / 12))));
  const low = points[0], high = points[points.length - 1];
  const scale = each.log ? (value) => Math.log(value / low) / Math.log(high / low) : (value) => (value - low) / (high - low);
  const back = each.log ? (share) => low * Math.pow(high / low, share) : (share) => low + share * (high - low);
  return {
    names: Array.from({ length: count }, (_, i) => short(back((i + 0.5) / count))),
    of: Int16Array.from(values, (value) => Math.min(count - 1, Math.max(0, Math.floor(count * scale(value))))),
  };
}

function mapOption(colors, across, up, data, scale, xName, yName, format) {
  return {
    grid: { left: 70, right: 84, top: 14, bottom: 52 },
    tooltip: { formatter: ({ value }) => `${xName} ${across[value[0]]}\n${yName} ${up[value[1]]}\n${format(value)}` },
    xAxis: { type: "category", data: across, name: xName, nameLocation: "middle", nameGap: 30, nameTextStyle: { color: colors.soft },
      axisLabel: { color: colors.soft, fontSize: 11, hideOverlap: true }, axisLine: { lineStyle: { color: colors.line } }, axisTick: { show: false } },
    yAxis: { type: "category", data: up, name: yName, nameLocation: "middle", nameGap: 50, nameTextStyle: { color: colors.soft },
      axisLabel: { color: colors.soft, fontSize: 11, hideOverlap: true }, axisLine: { lineStyle: { color: colors.line } }, axisTick: { show: false } },
    visualMap: { type: "continuous", min: scale.low, max: scale.high, dimension: 2, calculable: true, right: 0, top: "middle", itemHeight: 150, itemWidth: 12,
      formatter: (value) => short(scale.log ? Math.exp(value) : value), textStyle: { color: colors.soft }, inRange: { color: (scale.flip ? [...STOPS].reverse() : STOPS).map(rgb) },
      outOfRange: { color: colors.dead }, seriesIndex: 0 },
    series: [
      { type: "heatmap", data: data.filled, label: { show: data.filled.length < 1500, fontSize: 11, color: "#fff", formatter: ({ value }) => (value[4] ? "" : "×") }, itemStyle: { borderWidth: 0 } },
      { type: "heatmap", data: data.empty, itemStyle: { color: colors.dead, opacity: 0.45 } },
    ],
  };
}

function heatView(state, box) {
  const parameters = state.rows.measures.filter((each) => each.role === "parameter" && each.log !== undefined && varies(each));
  if (parameters.length < 2 || state.count < LEAST_ROWS) return false;
  const results = state.rows.measures.filter((each) => each.role === "metric" || each.role === "margin");
  const weight = (each) => (state.rows.influence[state.goals[0]] || [])[state.rows.measures.filter((one) => one.role === "parameter").indexOf(each)]?.[0] || 0;
  const first = [...parameters].sort((a, b) => weight(b) - weight(a));
  let [x, y, z] = [first[0].name, first[1].name, state.goals[0]];
  const cells = new Map();
  const cell = (name) => cells.get(name) || cells.set(name, cellsOf(state.measures.get(name))).get(name);
  const picture = element("div", { className: "chart tall", role: "img" });
  const options = (list) => list.map((each) => [each.name, heading(each)]);
  const draw = () => entry.draw();
  box.append(
    element("div", { className: "bar" },
      choice("Across", options(parameters), x, (name) => { x = name; draw(); }),
      choice("Upwards", options(parameters), y, (name) => { y = name; draw(); }),
      choice("Best", options(results), z, (name) => { z = name; draw(); })),
    picture, element("p", { className: "note" }, "The best row of each cell over everything else, among those that the filters leave and that keep the limits; × where none of them keeps the limits; grey where none is stable. A click takes that row."));

  function option(colors) {
    const [a, b, each] = [cell(x), cell(y), state.measures.get(z)], values = state.values(z), floor = each.sense === "floor";
    const size = a.names.length * b.names.length, best = new Int32Array(size).fill(-1), seen = new Uint8Array(size);
    const better = (i, j) => j < 0 || state.feasible[i] > state.feasible[j] || (state.feasible[i] === state.feasible[j] && (floor ? values[i] > values[j] : values[i] < values[j]));
    for (let i = 0; i < state.count; i++) {
      if (!state.alive[i] || a.of[i] < 0 || b.of[i] < 0) continue;
      const at = b.of[i] * a.names.length + a.of[i];
      seen[at] = 1;
      const there = Number.isFinite(values[i]) || (floor && values[i] === Infinity); // a margin may be infinitely good
      if (there && state.stable[i] && better(i, best[at])) best[at] = i;
    }
    const log = each.log, scaled = (value) => (log ? Math.log(value) : value), filled = [], empty = [];
    best.forEach((i, at) => {
      const [p, q] = [at % a.names.length, Math.floor(at / a.names.length)];
      if (i >= 0 && (!log || values[i] > 0)) filled.push([p, q, scaled(values[i]), i, state.feasible[i]]);
      else if (seen[at]) empty.push([p, q, 0]);
    });
    const sorted = filled.map((one) => one[2]).filter(Number.isFinite).sort((p, q) => p - q), cut = (share) => sorted[Math.floor(share * (sorted.length - 1))];
    const scale = { log, flip: floor, low: sorted.length ? cut(floor ? 0.05 : 0) : 0, high: sorted.length ? cut(floor ? 1 : 0.95) : 1 };
    if (!(scale.high > scale.low)) scale.high = scale.low + Math.max(1e-9, 1e-3 * Math.abs(scale.low));
    for (const one of filled) if (one[2] === Infinity) one[2] = scale.high; // no colour lies beyond
    picture.setAttribute("aria-label", `best ${heading(each)} over ${x} and ${y}, ${filled.length} cells with a stable row`);
    const said = ([, , , i, good]) => `${heading(each)} ${written(each, values[i])}${good ? "" : ", breaks a limit"}\n${state.rows.names[i] || ""}`;
    return mapOption(colors, a.names, b.names, { filled, empty }, scale, heading(state.measures.get(x)), heading(state.measures.get(y)), (value) => (value.length < 4 ? "none is stable" : said(value)));
  }

  const entry = surface(picture, option);
  entry.chart.on("click", ({ value }) => value.length > 3 && state.choose(value[3]));
  state.on(["filter"], later(draw, 160));
  return true;
}

const varies = (each) => each.columns[0].some((value) => value !== each.columns[0][0]);

function stabilityView(state, box) {
  const { rows } = state, parameters = rows.measures.filter((each) => each.role === "parameter" && varies(each));
  if (!parameters.length || state.count < LEAST_ROWS || rows.tissues.length < 2) return false;
  let name = parameters[0].name;
  const picture = element("div", { className: "chart tall", role: "img" });
  box.append(
    element("div", { className: "bar" }, choice("Upwards", parameters.map((each) => [each.name, heading(each)]), name, (chosen) => { name = chosen; entry.draw(); })),
    picture, element("p", { className: "note" }, `Share of the rows that the filters leave which are stable for a ${rows.group} and keep the limits of the margins there; × where some are stable but none keeps them.`));

  function option(colors) {
    const cell = cellsOf(state.measures.get(name)), filled = [], empty = [];
    const limits = [...state.limits].map(([key, limit]) => [state.measures.get(key), limit]).filter(([each]) => each.role === "margin" && each.tissues);
    rows.tissues.forEach((_, t) => {
      const all = new Uint32Array(cell.names.length), stable = new Uint32Array(cell.names.length), kept = new Uint32Array(cell.names.length);
      for (let i = 0; i < state.count; i++) {
        const at = cell.of[i];
        if (!state.alive[i] || at < 0) continue;
        all[at]++;
        if (rows.status[t * state.count + i] !== 0) continue;
        stable[at]++;
        if (limits.every(([each, limit]) => (each.sense === "floor" ? each.columns[t][i] >= limit : each.columns[t][i] <= limit))) kept[at]++;
      }
      all.forEach((count, at) => {
        if (stable[at]) filled.push([t, at, kept[at] / count, stable[at] / count, kept[at] > 0]);
        else if (count) empty.push([t, at, 0]);
      });
    });
    picture.setAttribute("aria-label", `share of stable rows over ${name} and ${rows.group}`);
    const percent = (share) => `${(100 * share).toFixed(share > 0 && share < 0.01 ? 2 : 0)} %`;
    return mapOption(colors, rows.tissues, cell.names, { filled, empty }, { low: 0, high: 1, log: false }, rows.group, heading(state.measures.get(name)),
      (value) => (value.length < 4 ? "none is stable" : `stable ${percent(value[3])}, margins kept ${percent(value[2])}`));
  }

  const entry = surface(picture, option);
  state.on(["filter"], later(() => entry.draw(), 160));
  return true;
}

function influenceView(state, box) {
  const { influence, tissues } = state.rows, names = Object.keys(influence);
  const parameters = state.rows.measures.filter((each) => each.role === "parameter");
  if (!names.length || !parameters.length) return false;
  let name = names.includes(state.goals[0]) ? state.goals[0] : names[0];
  const picture = element("div", { className: "chart", role: "img" });
  box.append(
    element("div", { className: "bar" }, choice("Of", names.map((one) => [one, heading(state.measures.get(one))]), name, (chosen) => { name = chosen; entry.draw(); })),
    picture, element("p", { className: "note" }, "Share of the variance over all rows that a parameter explains alone (first-order index); what is missing to 100 % is in their interplay. A row that is not stable counts as twice the worst."));

  function option(colors) {
    const shares = influence[name], width = shares[0].length;
    // Of one tissue the worst is that one.
    const places = width > 2 ? [`worst ${state.rows.group}`, ...tissues] : width > 1 ? tissues : ["all"];
    const order = parameters.map((_, k) => k).sort((p, q) => shares[p][0] - shares[q][0]);
    picture.setAttribute("aria-label", [...order].reverse().map((k) => `${parameters[k].head} ${(100 * shares[k][0]).toFixed(0)} %`).join(", "));
    return {
      grid: { left: 90, right: 20, top: 34, bottom: 42 },
      legend: { top: 4, textStyle: { color: colors.soft, fontSize: 11 }, itemHeight: 8, itemWidth: 14 },
      tooltip: { trigger: "axis", valueFormatter: (value) => `${value.toFixed(1)} %` },
      xAxis: axis(colors, "explained alone [%]", false, { nameGap: 26, min: 0, scale: false }),
      yAxis: { type: "category", data: order.map((k) => parameters[k].head), axisLabel: { color: colors.soft }, axisLine: { lineStyle: { color: colors.line } }, axisTick: { show: false } },
      series: places.map((place, t) => ({ type: "bar", name: place, barMaxWidth: 14, data: order.map((k) => 100 * shares[k][t]), itemStyle: { color: colors.series[t % colors.series.length] } })),
    };
  }

  const entry = surface(picture, option);
  return true;
}
