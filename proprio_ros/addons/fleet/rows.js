// The rows of a batch: search, choose, order, and what each says; its numbers come ready to be read.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent), STEP = 100;
  const SOURCE = 0, NAME = 1, JOINED = 2, WHEN = 3, SPAN = 4, VALUE = 5, LOW = 6, HIGH = 7, VERDICT = 8, CAUSE = 9, REASONS = 10,
    NOTES = 11, JOINTS = 12, PAGE = 13, FAR = 14;
  const at = (id) => document.getElementById(id);
  const find = at("find"), source = at("source"), verdict = at("verdict"), cause = at("cause"), count = at("count"), more = at("more");
  const body = at("list").querySelector("tbody"), heads = [...at("list").querySelectorAll("th button")];
  const names = heads.map((head) => head.textContent);
  const made = (tag, words, about = {}) => Object.assign(document.createElement(tag), { textContent: words }, about);
  const words = ([sentence, ...numbers]) => data.sentences[sentence].map((piece, n) => piece + (numbers[n] ?? "")).join("");
  const path = (row) => data.sources[row[SOURCE]][1] + row[JOINED] + row[NAME];
  const quoted = (word) => (/^[\w@%+=:,./-]+$/.test(word) ? word : "'" + word.replaceAll("'", "'\"'\"'") + "'");
  const grasp = data.verdicts.map((each) => each.startsWith("grasp "));
  const texts = [];
  const text = (n) => (texts[n] ??= [path(data.rows[n]), data.verdicts[data.rows[n][VERDICT]], ...data.rows[n][REASONS].map(words)]
    .join(" ").toLowerCase());
  // what has none comes last, whichever way
  const number = (word) => (word === "" ? null : +word);
  const KEYS = {
    "": () => 0, when: (row) => row[WHEN] || null, value: (row) => number(row[VALUE]),
    interval: (row) => (row[LOW] === "" ? null : row[HIGH] - row[LOW]), verdict: (row) => row[VERDICT],
  };
  let order = "", down = false, shown = [];

  const fill = (select, all) => all.forEach((label, n) => select.append(made("option", label.length > 60 ? label.slice(0, 58) + "\u2026" : label, { value: n })));
  fill(source, data.sources.map((each) => each[0]));
  fill(verdict, data.verdicts);
  fill(cause, data.causes);
  if (data.rows.some((row) => row[FAR])) verdict.append(made("option", "far from the others of its source", { value: "far" }));

  const detail = (row) => {
    const cell = made("td", "", { colSpan: heads.length + 1 }), box = made("tr", "", { className: "detail" });
    for (const [sentences, kind] of [[row[REASONS], ""], [row[NOTES], "small"]]) {
      if (!sentences.length) continue;
      const list = made("ul", "", { className: kind });
      list.append(...sentences.map((each) => made("li", words(each))));
      cell.append(list);
    }
    const [begin, end, span] = row[SPAN], seconds = end === null ? [] : [`${begin} to ${end} s`], joints = data.joints[row[JOINTS]];
    cell.append(made("p", [path(row), ...seconds, ...(joints ? [joints] : [])].join("; "), { className: "small" }));
    const failed = data.verdicts[row[VERDICT]] === "failed";
    cell.append(made("p", failed ? "What is in it:" : "Its page is written by:", { className: "small" }));
    const command = failed ? `proprio check ${quoted(path(row))}${data.check}` : `proprio replay ${quoted(path(row))}${span && ` --span ${span}`}${data.replay} --report row.html`;
    cell.append(made("pre", command));
    box.append(cell);
    return box;
  };

  const drawn = (n) => {
    const row = data.rows[n], line = document.createElement("tr"), name = made("button", row[NAME], { type: "button" });
    name.setAttribute("aria-expanded", "false");
    name.addEventListener("click", () => {
      const open = name.getAttribute("aria-expanded") === "true";
      if (open) line.nextSibling.remove();
      else line.after(detail(row));
      name.setAttribute("aria-expanded", String(!open));
    });
    const interval = row[LOW] === "" ? "" : `${row[LOW]} to ${row[HIGH]}`;
    const of = { source: data.sources[row[SOURCE]][0], when: row[WHEN], value: row[VALUE], interval };
    const why = row[CAUSE] < 0 ? "" : data.causes[row[CAUSE]], verdict = data.verdicts[row[VERDICT]];
    for (const head of heads) {
      const key = head.dataset.key, cell = made("td", of[key] ?? "");
      cell.dataset.name = names[heads.indexOf(head)];
      if (key === "") { cell.className = "label"; cell.append(name); }
      if (key === "value" || key === "interval") cell.className = "number";
      if (key === "when") cell.className = "when";
      if (key === "verdict") {
        cell.textContent = why && why !== verdict && why.length < 40 ? `${verdict}: ${why}` : verdict;
        if (row[FAR]) cell.textContent += ", far from the others";
      }
      line.append(cell);
    }
    const last = made("td", "");
    if (row[PAGE]) last.append(made("a", "page", { href: row[PAGE] }));
    line.append(last);
    return line;
  };

  const extend = () => {
    const from = body.querySelectorAll("tr:not(.detail)").length;
    body.append(...shown.slice(from, from + STEP).map(drawn));
    more.hidden = from + STEP >= shown.length;
  };
  const draw = () => {
    const asked = find.value.toLowerCase().split(/\s+/).filter(Boolean);
    shown = [];
    data.rows.forEach((row, n) => {
      if (source.value !== "" && row[SOURCE] !== +source.value) return;
      if (verdict.value === "far" ? !row[FAR] : verdict.value === "" ? grasp[row[VERDICT]] : row[VERDICT] !== +verdict.value) return;
      if (cause.value !== "" && row[CAUSE] !== +cause.value) return;
      if (asked.every((word) => text(n).includes(word))) shown.push(n);
    });
    const way = down ? -1 : 1, keys = data.rows.map(KEYS[order]);
    shown.sort((a, b) => {
      const [one, other] = [keys[a], keys[b]];
      if (one === null || other === null) return (one === null) - (other === null) || a - b;
      return way * (one > other) - way * (one < other) || a - b;
    });
    list();
  };
  const list = () => {
    count.textContent = `${shown.length} of ${data.rows.length}`;
    body.replaceChildren();
    extend();
  };
  const clear = () => { for (const each of [find, source, verdict, cause]) each.value = ""; };

  for (const head of heads) {
    if (!(head.dataset.key in KEYS)) continue;
    head.addEventListener("click", () => {
      down = order === head.dataset.key && !down;
      order = head.dataset.key;
      for (const each of heads) each.parentNode.removeAttribute("aria-sort");
      head.parentNode.setAttribute("aria-sort", down ? "descending" : "ascending");
      draw();
    });
  }
  find.addEventListener("input", draw);
  for (const select of [source, verdict, cause]) select.addEventListener("change", draw);
  more.addEventListener("click", extend);
  for (const jump of document.querySelectorAll(".jump")) {
    jump.addEventListener("click", () => { clear(); cause.value = jump.dataset.cause ?? ""; verdict.value = jump.dataset.verdict ?? ""; draw(); });
  }

  // a dot of a plot opens its row
  for (const figure of document.querySelectorAll("[data-dots]")) {
    const chart = figure.querySelector("svg.chart"), groups = figure.dataset.dots.split(" ").map((group) => group.split(","));
    let from = [0, 0];
    chart.addEventListener("pointerdown", (event) => { from = [event.clientX, event.clientY]; });
    chart.addEventListener("click", (event) => {
      if (Math.hypot(event.clientX - from[0], event.clientY - from[1]) > 4) return;
      let [nearest, row] = [12, -1];
      chart.querySelectorAll("path.dots").forEach((dots, series) => {
        const to = dots.getScreenCTM();
        [...dots.getAttribute("d").matchAll(/M([-\d.e]+),([-\d.e]+)/g)].forEach(([, x, y], n) => {
          const off = Math.hypot(to.a * x + to.e - event.clientX, to.d * y + to.f - event.clientY);
          if (off < nearest) [nearest, row] = [off, +groups[series][n]];
        });
      });
      if (row < 0) return;
      clear();
      find.value = path(data.rows[row]);
      shown = [row];
      list();
      body.querySelector("button").click();
      body.firstChild.scrollIntoView({ block: "center" });
    });
  }
  draw();
})();
