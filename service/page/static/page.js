// Plots and polling. The data of a plot stand in the page as JSON; a page without script shows them as tables.
"use strict";

const INK = "#1d2b36", LINE = "#dfe5ea";
const COLOURS = ["#1b5e8c", "#d1731f", "#2c7a4b", "#8b3a62", "#6b5b95", "#4d8f9c", "#a68a00", "#7a4a2b"];
const CONFIG = { displaylogo: false, responsive: true, showSendToCloud: false, modeBarButtonsToRemove: ["select2d", "lasso2d"] };
const LAYOUT = {
  font: { family: "system-ui, sans-serif", color: INK, size: 13 }, margin: { l: 70, r: 20, t: 20, b: 50 },
  paper_bgcolor: "#fff", plot_bgcolor: "#fff", hovermode: "closest", legend: { orientation: "h", y: 1.08 },
};
const axis = (title, more) => ({ title: { text: title }, gridcolor: LINE, zeroline: false, linecolor: LINE, ticks: "outside", ...more });
const faded = (colour, alpha) => colour + Math.round(255 * alpha).toString(16).padStart(2, "0");

// A band as one closed outline, behind its median.
function band(x, low, high, colour, name, alpha = 0.18) {
  return { x: [...x, ...[...x].reverse()], y: [...high, ...[...low].reverse()], fill: "toself", fillcolor: faded(colour, alpha),
    line: { width: 0 }, mode: "lines", hoverinfo: "skip", legendgroup: name, showlegend: false };
}

function drift(data) {
  const traces = [];
  data.series.forEach((one, k) => {
    const names = ["month", "c_ratio", "low", "high", "paths", "events", "line", "version"];
    const months = one.months.map((row) => Object.fromEntries(names.map((name, j) => [name, row[j]])));
    const colour = COLOURS[k % COLOURS.length], x = months.map((m) => m.month + "-15");
    traces.push(band(x, months.map((m) => m.low), months.map((m) => m.high), colour, one.name));
    traces.push({ x, y: months.map((m) => m.c_ratio), mode: "lines+markers", name: one.name, legendgroup: one.name,
      line: { color: colour, width: 2 }, marker: { size: 6 }, customdata: months.map((m) => m.version === null ? one.url : one.versions[m.version].url),
      text: months.map((m) => `${m.paths} paths, ${m.events} events`), hovertemplate: "%{x|%Y-%m}: %{y:.4f}<br>%{text}<extra>" + one.name + "</extra>" });
    const lines = months.filter((m) => m.line), at = lines.map((m) => m.month + "-15");
    if (lines.length) {
      traces.push(band(at, lines.map((m) => m.line[1]), lines.map((m) => m.line[2]), colour, one.name, 0.06));
      traces.push({ x: at, y: lines.map((m) => m.line[0]), mode: "lines", line: { color: colour, width: 1.5, dash: "dash" }, name: one.name + ", season and slope",
        legendgroup: one.name, showlegend: false, hovertemplate: "season and slope: %{y:.4f}<extra>" + one.name + "</extra>" });
    }
    one.versions.forEach((v) => traces.push({ x: [v.middle], y: [v.ratio], error_y: { type: "data", array: [v.sigma], color: colour },
      mode: "markers", marker: { size: 11, symbol: v.dipole === "Y" ? "square-open" : "diamond-open", color: colour, line: { width: 2 } },
      name: `${one.name} ${v.dipole} version`, legendgroup: one.name, showlegend: false, customdata: [v.url],
      hovertemplate: `version ${v.window}, ${v.dipole}: %{y:.4f}<extra>${one.name}</extra>` }));
  });
  // what is shown are medians and versions: a path that is deaf may widen a band by a factor
  const shown = data.series.flatMap((one) => [...one.months.map((row) => row[1]), ...one.versions.flatMap((v) => [v.ratio - v.sigma, v.ratio + v.sigma])]);
  const low = Math.min(0.98, ...shown), high = Math.max(1.02, ...shown), edge = 0.08 * (high - low);
  const layout = { ...LAYOUT, xaxis: axis("month (UTC)", { type: "date" }), yaxis: axis("C / C of the first year", { range: [low - edge, high + edge] }) };
  return [traces, layout];
}

// The years of a station one beside the other: paths that a year does not have are empty there.
function matrix(data) {
  const keys = new Map(data.years.flatMap((year) => year.paths).map((path) => [path.join(" "), path]));
  const paths = [...keys.values()].sort((a, b) => a[0] - b[0] || a[1].localeCompare(b[1]));
  const months = data.years.flatMap((year) => year.months), z = paths.map(() => []);
  data.years.forEach((year) => {
    const rows = new Map(year.paths.map((path, k) => [path.join(" "), year.values[k]]));
    paths.forEach((path, k) => z[k].push(...(rows.get(path.join(" ")) ?? year.months.map(() => null))));
  });
  const span = Math.max(0.02, ...z.map((row) => Math.max(...row.map((v) => Math.abs(v ?? 0)))));
  const url = (path, k) => `/stations/${encodeURIComponent(data.station)}/${path[0]}/${encodeURIComponent(path[1])}/${months[k]}`;
  const trace = { type: "heatmap", x: months.map((m) => m + "-15"), y: paths.map((path) => path.join(" ")), z: z.map((row) => row.map((v) => v === null ? null : 100 * v)),
    customdata: z.map((row, p) => row.map((v, k) => v === null ? null : url(paths[p], k))), colorscale: [[0, "#b2452d"], [0.5, "#f7f7f5"], [1, "#1b5e8c"]], zmin: -100 * span, zmax: 100 * span,
    colorbar: { title: { text: "change of C, %" } }, hovertemplate: "%{y}, %{x|%Y-%m}: %{z:+.2f} %<extra></extra>" };
  const layout = { ...LAYOUT, margin: { l: 90, r: 20, t: 20, b: 50 }, xaxis: axis("month (UTC)", { type: "date" }),
    yaxis: axis("antenna and dipole", { type: "category", autorange: "reversed" }) };
  return [[trace], layout];
}

const MICRO = 1e6;

function curve(data) {
  const traces = [];
  data.curves.forEach((one, k) => {
    const colour = COLOURS[k % COLOURS.length], x = one.frequency_mhz;
    const known = x.map((_, j) => j).filter((j) => one.c[j] !== null);
    const beside = (sign) => known.map((j) => MICRO * (one.c[j] + sign * one.c_sigma_stat[j]));
    traces.push(band(known.map((j) => x[j]), beside(-1), beside(1), colour, one.name));
    traces.push({ x, y: one.c.map((c) => c === null ? null : MICRO * c), mode: "lines", name: one.name, legendgroup: one.name, line: { color: colour, width: 2 },
      hovertemplate: "%{x} MHz: %{y:.2f} µV<extra>" + one.name + "</extra>" });
  });
  const layout = { ...LAYOUT, margin: { l: 95, r: 20, t: 20, b: 50 }, xaxis: axis("frequency, MHz"), yaxis: axis("C(ν), µV per ADC unit", { rangemode: "tozero" }) };
  return [traces, layout];
}

const PLOTS = { drift, matrix, curve };
document.querySelectorAll(".plot").forEach((place) => {
  const data = JSON.parse(document.getElementById(place.dataset.source).textContent);
  const [traces, layout] = PLOTS[place.dataset.plot](data);
  Plotly.newPlot(place, traces, layout, CONFIG).then(() => place.setAttribute("data-ready", "yes"));
  place.on("plotly_click", (event) => { const url = event.points[0].customdata; if (typeof url === "string") location.assign(url); });
});

// The page of jobs asks again while something is open.
const jobs = document.querySelector("[data-poll]");
if (jobs) {
  const poll = async () => {
    const answer = await fetch(location.href, { headers: { Accept: "text/html" } });
    if (answer.ok) {
      const fresh = new DOMParser().parseFromString(await answer.text(), "text/html").querySelector("[data-poll]");
      jobs.replaceChildren(...fresh.childNodes);
      jobs.dataset.poll = fresh.dataset.poll;
    }
    if (jobs.dataset.poll === "open") setTimeout(poll, 2000);
  };
  if (jobs.dataset.poll === "open") setTimeout(poll, 2000);
}
