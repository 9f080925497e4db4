// Values under the pointer; drag to stretch the axis, double-click for all of it.
(() => {
  const WIDTH = 640, LEFT = 74, INSIDE = 552;
  const tip = document.body.appendChild(document.createElement("div"));
  tip.className = "tip";
  tip.hidden = true;
  const short = (value) => String(Number(value.toPrecision(4))).replace("-", "\u2212");

  for (const chart of document.querySelectorAll("svg.chart")) {
    const log = "log" in chart.dataset, x0 = +chart.dataset.x0, x1 = +chart.dataset.x1;
    const valueAt = (px) => x0 + (px / INSIDE) * (x1 - x0);
    let view = [0, INSIDE], begin = null;

    const plots = [...chart.querySelectorAll("svg.plot")].map((plot) => {
      const y0 = +plot.dataset.y0, y1 = +plot.dataset.y1, height = +plot.getAttribute("height");
      const value = (px) => { const y = y1 + (px / height) * (y0 - y1); return "log" in plot.dataset ? 10 ** y : y; };
      const series = [...plot.querySelectorAll("[data-name]")].map((path) => ({
        name: path.dataset.name, unit: path.dataset.unit, steps: path.classList.contains("steps"),
        points: [...path.getAttribute("d").matchAll(/[ML]([-\d.e]+),([-\d.e]+)/g)].map((m) => [+m[1], value(+m[2])]),
      }));
      const line = plot.appendChild(document.createElementNS(plot.namespaceURI, "path"));
      line.setAttribute("class", "pointer");
      return { plot, height, series, line, top: +plot.getAttribute("y") };
    });

    const near = ({ points, steps }, px) => {
      if (steps) return points.filter((point) => point[0] <= px).pop();
      const best = points.reduce((a, b) => (Math.abs(b[0] - px) < Math.abs(a[0] - px) ? b : a));
      return Math.abs(best[0] - px) < 0.04 * (view[1] - view[0]) ? best : undefined;
    };
    const at = (event) => {
      const box = chart.getBoundingClientRect();
      const share = (((event.clientX - box.left) / box.width) * WIDTH - LEFT) / INSIDE;
      return view[0] + Math.min(Math.max(share, 0), 1) * (view[1] - view[0]);
    };
    const hide = () => { tip.hidden = true; begin = null; for (const { line } of plots) line.removeAttribute("d"); };

    const show = (event) => {
      const px = at(event), x = valueAt(px);
      const lines = [`${short(log ? 10 ** x : x)} ${chart.dataset.unit}`];
      for (const { height, series, line } of plots) {
        line.setAttribute("d", `M${px},0V${height}` + (begin === null ? "" : `M${begin},0V${height}`));
        for (const one of series) {
          const point = one.points.length ? near(one, px) : undefined;
          if (point) lines.push(`${one.name}: ${short(point[1])} ${one.unit}`);
        }
      }
      tip.textContent = lines.join("\n");
      tip.hidden = false;
      const left = event.clientX + 16 + tip.offsetWidth > innerWidth ? event.clientX - 12 - tip.offsetWidth : event.clientX + 16;
      tip.style.left = `${Math.max(left, 4)}px`;
      tip.style.top = `${Math.max(Math.min(event.clientY + 12, innerHeight - tip.offsetHeight - 4), 4)}px`;
    };

    const stretch = (from, to) => {
      view = [from, to];
      for (const { plot, height } of plots) plot.setAttribute("viewBox", `${from} 0 ${to - from} ${height}`);
      const low = valueAt(from), high = valueAt(to), power = 10 ** Math.floor(Math.log10((high - low) / 7));
      const step = [1, 2, 5, 10].map((digit) => digit * power).find((each) => (high - low) / each < 7);
      const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
      const ticks = chart.querySelector(".ticks"), mark = ticks.querySelector("text");
      const y = mark ? mark.getAttribute("y") : "0";
      ticks.replaceChildren();
      for (let n = Math.ceil(low / step - 1e-9); n * step <= high + 1e-9 * step; n++) {
        const place = LEFT + ((n * step - low) / (high - low)) * INSIDE;
        const path = ticks.appendChild(document.createElementNS(ticks.namespaceURI, "path"));
        path.setAttribute("d", plots.map(({ top, height }) => `M${place},${top}v${height}`).join(""));
        const text = ticks.appendChild(document.createElementNS(ticks.namespaceURI, "text"));
        for (const [key, value] of [["x", place], ["y", y], ["text-anchor", "middle"]]) text.setAttribute(key, value);
        text.textContent = (n * step).toFixed(digits).replace("-", "\u2212");
      }
    };

    chart.addEventListener("pointermove", show);
    chart.addEventListener("pointerleave", hide);
    chart.addEventListener("pointerdown", (event) => {
      if (event.pointerType !== "touch" && !log) { begin = at(event); event.preventDefault(); }
      show(event);
    });
    chart.addEventListener("pointerup", (event) => {
      const from = begin, to = at(event);
      begin = null;
      if (from !== null && Math.abs(to - from) > 0.02 * (view[1] - view[0])) stretch(Math.min(from, to), Math.max(from, to));
      show(event);
    });
    chart.addEventListener("dblclick", () => { if (!log) stretch(0, INSIDE); });
  }
})();
