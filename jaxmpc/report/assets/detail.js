// The chosen row: its parameters, every tissue, its charts, its params.toml.

// A float as TOML wants it: with a point or an exponent, and every bit of it.
function tomlNumber(value, whole) {
  if (whole) return String(Math.round(value));
  const text = String(value);
  return /[.e]/.test(text) ? text : `${text}.0`;
}

function tomlOf(state, row) {
  const own = state.rows.details[row]?.toml;
  if (own) return own;
  return state.rows.toml.map((piece) => {
    if (typeof piece === "string") return piece;
    const each = state.measures.get(piece.name);
    return each ? tomlNumber(each.columns[0][row], each.whole) : state.rows.names[row];
  }).join("");
}

function detailView(state, box) {
  const { rows } = state;
  const body = element("div"), charted = Object.keys(rows.details).map(Number).filter((k) => rows.details[k].charts.length);
  box.append(body);

  function cells(head, lines) {
    const found = element("table", {}, element("tr", {}, ...head.map((text) => element("th", { scope: "col", textContent: text }))));
    for (const [first, ...others] of lines) {
      found.append(element("tr", {}, element("th", { scope: "row", textContent: first }), ...others.map((text) => element("td", { textContent: text }))));
    }
    return element("div", { className: "scroll", tabIndex: 0 }, found);
  }

  function show() {
    const i = state.chosen;
    discard(body);
    const jump = () => element("div", { className: "front" }, ...charted.slice(0, 40).map((k) => element("button", { textContent: rows.names[k], onclick: () => state.choose(k) })));
    if (i < 0) {
      body.append(element("p", { className: "note" }, "Choose a row: a click in the table, on the front or in a map." + (charted.length ? ` With charts: ${rows.note}` : "")), jump());
      return;
    }
    const broken = [...state.limits].filter(([name, limit]) => {
      const each = state.measures.get(name), value = state.values(name)[i];
      return !(each.sense === "floor" ? value >= limit : value <= limit);
    }).map(([name]) => state.measures.get(name).head);
    const wrong = [...(state.stable[i] ? [] : ["is not OK"]), ...(broken.length ? [`breaks the limit of ${broken.join(", ")}`] : [])];
    body.append(element("h3", { textContent: rows.names[i] }),
      element("p", { className: wrong.length ? "bad" : "good", textContent: wrong.join(" and ") || "keeps every limit" }));
    const parameters = rows.measures.filter((each) => each.role === "parameter"), others = rows.measures.filter((each) => each.role === "other");
    const halves = element("div", { className: "halves" });
    const left = element("div"), right = element("div");
    if (parameters.length + others.length) left.append(cells(["parameter", "value"], [...parameters, ...others].map((each) => [heading(each), written(each, each.worst[i])])));
    const results = rows.measures.filter((each) => each.role === "metric" || each.role === "margin");
    // Of one tissue the worst is that one.
    const worst = (text) => (rows.tissues.length > 1 ? [text] : []);
    left.append(cells(["", ...rows.tissues, ...worst("worst")], [
      ["status", ...rows.tissues.map((_, t) => rows.states[rows.status[t * state.count + i]].name), ...worst("")],
      ...results.map((each) => [heading(each), ...rows.tissues.map((_, t) => (each.tissues || rows.tissues.length === 1 ? written(each, each.tissues ? each.columns[t][i] : each.worst[i]) : "")), ...worst(written(each, each.worst[i]))]),
    ]));
    const text = tomlOf(state, i);
    if (text) {
      const said = element("span", { className: "soft", role: "status" });
      const block = element("pre", { textContent: text, tabIndex: 0, id: "toml" });
      const copy = async () => {
        try {
          await navigator.clipboard.writeText(text);
          said.textContent = "copied";
        } catch {
          getSelection().selectAllChildren(block);
          said.textContent = document.execCommand("copy") ? "copied" : "marked: press Ctrl+C";
        }
      };
      right.append(element("div", { className: "bar" }, element("strong", { textContent: rows.file }),
        element("button", { textContent: "Copy", onclick: copy }), element("button", { textContent: "Save", id: "save-toml", onclick: () => save(rows.file, text) }), said), block);
    }
    halves.append(left, right);
    body.append(halves);
    const charts = rows.details[i]?.charts || [];
    if (charts.length) {
      const grid = element("div", { className: "charts" });
      body.append(grid);
      for (const chart of charts) {
        const picture = element("div", { className: "chart" });
        grid.append(picture);
        curveChart(picture, chart);
      }
    } else if (charted.length) {
      body.append(element("p", { className: "note" }, `No charts are kept of this row. They are of: ${rows.note}`), jump());
    }
  }

  state.on(["chosen", "tissue"], show);
  show();
}
