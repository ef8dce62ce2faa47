// What all views share: the tissue looked at, limits, filters, the chosen row; and who wants to know of changes.

function makeState(rows) {
  const count = rows.count, measures = new Map(rows.measures.map((each) => [each.name, each]));
  const state = {
    rows, count, measures,
    tissue: -1, // -1: the worst of all
    limits: new Map(rows.measures.filter((each) => each.limit !== null).map((each) => [each.name, each.limit])),
    ranges: new Map(), // by measure: [low, high]
    texts: new Map(), // by measure: a test of the table's filters
    goals: [0, 1, 2].map((i) => rows.goals[i] || ""),
    chosen: -1,
    alive: new Uint8Array(count).fill(1),
    feasible: new Uint8Array(count),
    stable: new Uint8Array(count),
    shown: count,
    kept: 0,
  };
  const listeners = { filter: [], feasible: [], tissue: [], goals: [], chosen: [] };
  state.on = (kinds, listener) => kinds.forEach((kind) => listeners[kind].push(listener));
  state.say = (kind) => listeners[kind].forEach((listener) => listener());

  // The values of a measure on the tissue looked at; those of all where it has none of its own.
  state.values = (name, tissue = state.tissue) => {
    const each = measures.get(name);
    return tissue >= 0 && each.tissues ? each.columns[tissue] : each.worst;
  };

  state.judge = () => {
    const { status, tissues } = rows, { tissue, feasible, stable } = state;
    stable.fill(1);
    tissues.forEach((_, t) => {
      if (tissue >= 0 && t !== tissue) return;
      for (let i = 0, at = t * count; i < count; i++) if (status[at + i]) stable[i] = 0;
    });
    feasible.set(stable);
    for (const [name, limit] of state.limits) {
      const values = state.values(name), floor = measures.get(name).sense === "floor";
      for (let i = 0; i < count; i++) if (!(floor ? values[i] >= limit : values[i] <= limit)) feasible[i] = 0;
    }
    state.say("feasible");
  };

  state.filter = () => {
    const { alive, feasible } = state;
    alive.fill(1);
    for (const [name, [low, high]] of state.ranges) {
      const values = state.values(name);
      for (let i = 0; i < count; i++) if (!(values[i] >= low && values[i] <= high)) alive[i] = 0;
    }
    for (const [name, test] of state.texts) {
      const values = name === "" ? null : state.values(name);
      for (let i = 0; i < count; i++) if (alive[i] && !test(values ? values[i] : i)) alive[i] = 0;
    }
    state.shown = state.kept = 0;
    for (let i = 0; i < count; i++) {
      state.shown += alive[i];
      state.kept += alive[i] & feasible[i];
    }
    state.say("filter");
  };

  state.setTissue = (tissue) => {
    state.tissue = tissue;
    state.say("tissue");
    state.judge();
    state.filter();
  };
  state.setLimit = (name, limit) => {
    if (limit === null) state.limits.delete(name);
    else state.limits.set(name, limit);
    state.judge();
    state.filter();
  };
  state.setRange = (name, range) => {
    if (range) state.ranges.set(name, range);
    else state.ranges.delete(name);
    state.filter();
  };
  state.clear = () => {
    state.ranges.clear();
    state.texts.clear();
    state.filter();
  };
  state.choose = (row) => {
    state.chosen = row;
    state.say("chosen");
  };
  return state;
}

const heading = (each) => (each.unit === "-" ? each.head : `${each.head} [${each.unit}]`);

function written(each, value) {
  if (value !== value) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  if (each.digits !== null && each.digits !== undefined && Math.abs(value) < 1e5) return value.toFixed(each.digits);
  return each.whole ? String(value) : String(Number(value.toPrecision(4)));
}

// Rows that no other beats in the goals; `goals` are [values, floor]. A margin may be infinitely good.
function paretoFront(goals, takes) {
  const rows = [], cost = goals.map(([values, floor]) => (floor ? (i) => -values[i] : (i) => values[i]));
  for (let i = 0; i < takes.length; i++) {
    if (takes[i] && cost.every((each) => each(i) < Infinity)) rows.push(i);
  }
  rows.sort((a, b) => {
    for (const each of cost) if (each(a) !== each(b)) return each(a) - each(b);
    return a - b;
  });
  // Along the first goal only the others matter: the rows met so far leave a falling staircase of them.
  const [second, third] = [cost[1], cost[2] || (() => 0)], stairs = [], front = [];
  let previous = -1;
  for (const i of rows) {
    const x = second(i), y = third(i);
    if (previous >= 0 && cost.every((each) => each(i) === each(previous))) {
      front.push(i); // as good as one of the front
      continue;
    }
    let low = 0, high = stairs.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (stairs[middle][0] <= x) low = middle + 1;
      else high = middle;
    }
    if (low > 0 && stairs[low - 1][1] <= y) continue;
    let end = low;
    while (end < stairs.length && stairs[end][1] >= y) end++;
    const begin = low > 0 && stairs[low - 1][0] === x ? low - 1 : low;
    stairs.splice(begin, end - begin, [x, y]);
    front.push(i);
    previous = i;
  }
  return front;
}
