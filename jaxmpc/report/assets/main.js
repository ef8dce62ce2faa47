// The page: what stands in it, and the one bar above all views.

function part(parent, title, ...classes) {
  const body = element("div");
  const found = element("section", { className: classes.join(" ") }, element("h2", { textContent: title }), body);
  parent.append(found);
  return { body, drop: () => found.remove() };
}

function topBar(state, cleared) {
  const { rows } = state, bar = element("div", { className: "bar top" });
  const said = element("span", { id: "shown", role: "status" });
  if (rows.tissues.length > 1) {
    bar.append(choice(rows.group[0].toUpperCase() + rows.group.slice(1), [["-1", "worst of all"], ...rows.tissues.map((name, t) => [String(t), name])], "-1", (value) => state.setTissue(Number(value))));
  }
  for (const each of rows.measures.filter((one) => one.limit !== null)) {
    const input = element("input", { type: "number", value: each.limit, step: "any", size: 6 });
    input.addEventListener("change", () => state.setLimit(each.name, input.value === "" ? null : Number(input.value)));
    bar.append(element("label", { title: `${each.text}; empty: no limit` }, `${each.head} ${each.sense === "floor" ? "≥" : "≤"} `, input, each.unit === "-" ? "" : ` ${each.unit}`));
  }
  bar.append(element("button", { textContent: "Clear filters", onclick: () => { cleared.forEach((clear) => clear()); state.clear(); } }), said);
  const tell = () => { said.textContent = `${state.shown} of ${state.count} rows shown, ${state.kept} of them keep every limit`; };
  state.on(["filter"], tell);
  tell();
  return bar;
}

function explore(state, main) {
  const cleared = [], { rows } = state;
  main.append(topBar(state, cleared));
  const wide = part(main, "All rows", "wide");
  parallelView(state, wide.body);
  const views = [["Pareto front", scatterView], ["Map of two parameters", heatView], [`Stability over ${rows.group}`, stabilityView], ["Importance", influenceView]];
  const grid = element("div", { className: "views" });
  main.append(grid);
  for (const [title, view] of views) {
    const made = part(grid, title);
    if (view(state, made.body) === false) made.drop();
  }
  const table = part(main, "Table", "wide");
  cleared.push(tableView(state, table.body));
  detailView(state, part(main, "Chosen row", "wide").body);
  if (!rows.exact) {
    const lean = rows.lean.length ? ` To keep the file small, ${rows.lean.join(", ")} ${rows.lean.length > 1 ? "are" : "is"} here for the worst ${rows.group} alone.` : "";
    main.append(element("p", { className: "note" }, `What was measured is here with 16 bits a number; parameters are exact.${lean}`));
  }
}

async function start() {
  const data = await readData();
  if (data.rows) {
    const state = makeState(data.rows);
    state.judge();
    state.filter();
    explore(state, document.getElementById("explorer"));
  }
  for (const box of document.querySelectorAll("[data-section]")) {
    curveChart(box, data.charts[Number(box.dataset.section)][Number(box.dataset.chart)]);
  }
  document.documentElement.dataset.ready = String(Math.round(performance.now()));
}

start().catch((error) => {
  document.body.prepend(element("p", { className: "bad", role: "alert", textContent: `This report could not be opened: ${error.message}. It needs a browser of 2023 or later.` }));
  throw error;
});
