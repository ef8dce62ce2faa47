// The Pareto front of any two or three goals, among the rows that the filters leave.

const SHADES = 8, MANY = 4000, CROWD = 300;

function scatterView(state, box) {
  const able = state.rows.measures.filter((each) => each.role !== "other");
  const options = able.map((each) => [each.name, heading(each)]);
  const set = (place) => (name) => {
    state.goals[place] = name;
    state.say("goals");
    entry.draw();
  };
  const picture = element("div", { className: "chart tall", role: "img" });
  const told = element("p", { className: "note", id: "front" });
  const choose = element("div", { className: "front" });
  box.append(
    element("div", { className: "bar" },
      choice("Across", options, state.goals[0], set(0)), choice("Upwards", options, state.goals[1], set(1)),
      choice("Third goal (colour)", [["", "none"], ...options], state.goals[2], set(2))),
    picture, told, choose);
  let points = [];

  function option(colors) {
    const [across, up, third] = state.goals.map((name) => state.measures.get(name));
    const x = state.values(across.name), y = state.values(up.name), z = third ? state.values(third.name) : null;
    const goals = [across, up, third].filter(Boolean).filter((each) => each.sense !== "none");
    const takes = state.alive.map((alive, i) => alive & state.feasible[i]);
    const costs = goals.map((each) => [state.values(each.name), each.sense === "floor"]);
    const front = costs.length > 1 ? paretoFront(costs, takes) : [];
    const logs = [across, up].map((each) => each.log), fits = (value, log) => Number.isFinite(value) && (!log || value > 0);
    points = [];
    const broken = [], shades = Array.from({ length: SHADES }, () => []);
    let low = Infinity, high = -Infinity;
    if (z) for (let i = 0; i < z.length; i++) if (takes[i] && Number.isFinite(z[i])) {
      low = Math.min(low, z[i]);
      high = Math.max(high, z[i]);
    }
    const zLog = third && third.log && low > 0;
    const shade = (value) => {
      const share = zLog ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
      return Number.isFinite(share) ? Math.min(SHADES - 1, Math.floor(SHADES * share)) : SHADES - 1;
    };
    // What breaks a limit by far would squeeze the rest into a corner.
    const frame = [x, y].map((values) => {
      let least = Infinity, most = -Infinity;
      for (let i = 0; i < values.length; i++) if (takes[i] && Number.isFinite(values[i])) {
        least = Math.min(least, values[i]);
        most = Math.max(most, values[i]);
      }
      return [least, most];
    });
    const inside = (value, [least, most], log) => !(most > -Infinity) || (log ? value <= 3 * most && value >= least / 3 : value <= most + (most - least || Math.abs(most)) && value >= least - (most - least || Math.abs(most)));
    let outside = 0, failed = 0;
    for (let i = 0; i < state.count; i++) {
      if (!state.alive[i]) continue;
      if (!fits(x[i], logs[0]) || !fits(y[i], logs[1])) {
        failed++;
        continue;
      }
      if (!inside(x[i], frame[0], logs[0]) || !inside(y[i], frame[1], logs[1])) {
        outside++;
        continue;
      }
      points.push(i);
      if (takes[i]) (shades[z ? shade(z[i]) : 2]).push([x[i], y[i]]);
      else broken.push([x[i], y[i]]);
    }
    const many = points.length > MANY, size = many ? 3 : 7;
    const cloud = (name, data, color, symbol, more = {}) => ({
      type: "scatter", name, data: many ? Float32Array.from(data.flat()) : data, large: many, largeThreshold: 1, progressive: 0,
      symbol, symbolSize: symbol === "rect" ? 5 : size, silent: true, itemStyle: { color, opacity: many ? 0.5 : 0.8 }, ...more,
    });
    const ends = front.filter((i) => fits(x[i], logs[0]) && fits(y[i], logs[1])).map((i) => [x[i], y[i], i]);
    const two = goals.length === 2 && !third && goals.includes(across) && goals.includes(up);
    told.textContent = `${front.length} ${front.length === 1 ? "row" : "rows"} on the front of ${goals.map((each) => each.head).join(", ")}; ` +
      `${broken.length} in grey break a limit; ${failed} without a finite value and ${outside} far outside are not drawn.` +
      (third && low < high ? ` Colour: ${heading(third)} from ${short(low)} (dark) to ${short(high)} (light).` : "");
    picture.setAttribute("aria-label", told.textContent);
    listed(front, goals);
    const at = state.chosen;
    return {
      grid: { left: 64, right: 20, top: 16, bottom: 46 },
      tooltip: { show: false },
      xAxis: axis(colors, heading(across), logs[0] && frame[0][1] / frame[0][0], { nameGap: 28 }),
      yAxis: axis(colors, heading(up), logs[1] && frame[1][1] / frame[1][0], { nameGap: 48 }),
      dataZoom: [{ type: "inside", zoomOnMouseWheel: "ctrl", moveOnMouseWheel: false, filterMode: "none" }],
      series: [
        cloud("breaks a limit", broken, colors.dead, many ? "circle" : "path://M0,0L8,8M8,0L0,8", many ? {} : { itemStyle: { color: "none", borderColor: colors.dead, borderWidth: 1.5 } }),
        ...shades.map((data, k) => cloud(`shade ${k}`, data, z ? rgb(RAMP[Math.round((255 * (k + 0.5)) / SHADES)]) : colors.series[0], "circle")),
        // Rings of a crowded front lie below its points, whose colour they would hide.
        { type: two ? "line" : "scatter", step: "end", symbol: "circle", symbolSize: 8, silent: true, z: ends.length > CROWD ? 1 : 4, data: ends.map(([a, b]) => [a, b]),
          lineStyle: { color: colors.accent, width: 1.5 }, itemStyle: { color: "transparent", borderColor: colors.accent, borderWidth: 2 } },
        { type: "scatter", symbol: "diamond", symbolSize: 16, z: 5, silent: true, data: at >= 0 && fits(x[at], logs[0]) && fits(y[at], logs[1]) ? [[x[at], y[at]]] : [],
          itemStyle: { color: colors.bad, borderColor: colors.page, borderWidth: 1 } },
      ],
    };
  }

  // Keys reach the front too: its first rows as buttons.
  function listed(front, goals) {
    choose.replaceChildren(...front.slice(0, 12).map((i) => element("button", {
      textContent: state.rows.names[i], onclick: () => state.choose(i),
      title: goals.map((each) => `${heading(each)} ${written(each, state.values(each.name)[i])}`).join(", "),
    })), ...(front.length > 12 ? [element("span", { className: "soft", textContent: ` and ${front.length - 12} more` })] : []));
  }

  const entry = surface(picture, option);
  entry.chart.getZr().on("click", (event) => {
    const [across, up] = state.goals.map((name) => name && state.values(name));
    let best = -1, least = 18 * 18;
    for (const i of points) {
      const [px, py] = entry.chart.convertToPixel({ gridIndex: 0 }, [across[i], up[i]]);
      const off = (px - event.offsetX) ** 2 + (py - event.offsetY) ** 2;
      if (off < least) [best, least] = [i, off];
    }
    if (best >= 0) state.choose(best);
  });
  const renew = later(() => entry.draw(), 160);
  state.on(["filter", "chosen"], renew);
}
