'use strict';
const COLORS = ['#0072b2', '#d55e00', '#009e73', '#cc79a7', '#e69f00', '#56b4e9', '#8c6bb1', '#7f7f7f'];

function cellValue(row, column) {
  const text = row.cells[column].dataset.value ?? row.cells[column].textContent;
  const number = Number(text);
  return text.trim() === '' || Number.isNaN(number) ? text : number;
}

function sortTable(header) {
  const table = header.closest('table');
  const column = header.cellIndex;
  const descending = header.getAttribute('aria-sort') === 'ascending';
  for (const other of table.tHead.rows[0].cells) other.removeAttribute('aria-sort');
  header.setAttribute('aria-sort', descending ? 'descending' : 'ascending');
  const rows = [...table.tBodies[0].rows];
  rows.sort((a, b) => {
    const x = cellValue(a, column), y = cellValue(b, column);
    if (typeof x === 'number' && typeof y === 'number') return x - y;
    if (typeof x === typeof y) return x.localeCompare(y, 'en', { numeric: true });
    return typeof x === 'number' ? -1 : 1;
  });
  if (descending) rows.reverse();
  table.tBodies[0].append(...rows);
}

// Plotly's own legend covers the curves where the names are many and the page is narrow.
function drawLegend(place, traces) {
  place.previousElementSibling.replaceChildren(...traces.map((trace, k) => {
    const name = document.createElement('button');
    name.textContent = trace.name;
    name.style.setProperty('--trace', trace.line.color);
    name.addEventListener('click', () => {
      const hidden = name.toggleAttribute('data-hidden');
      Plotly.restyle(place, { visible: !hidden }, k);
    });
    return name;
  }));
}

function drawPlots() {
  const style = getComputedStyle(document.documentElement);
  const [ink, quiet, line] = ['--ink', '--quiet', '--line'].map((name) => style.getPropertyValue(name));
  const family = getComputedStyle(document.body).fontFamily;
  const axis = { gridcolor: line, zerolinecolor: line, linecolor: line, automargin: true };
  for (const place of document.querySelectorAll('.plot')) {
    const figure = JSON.parse(place.nextElementSibling.textContent);
    const estimates = figure.data.filter((trace) => trace.name !== 'ground truth');
    const traces = figure.data.map((trace) => {
      const color = COLORS[estimates.indexOf(trace) % COLORS.length];
      return trace.name === 'ground truth'
        ? { ...trace, line: { color: ink, width: 3, dash: 'dot' } }
        : { ...trace, line: { color, width: 1.5 }, marker: { color, size: 5 } };
    });
    const layout = { ...figure.layout, title: undefined, font: { color: ink, size: 12, family },
      paper_bgcolor: 'rgba(0,0,0,0)', plot_bgcolor: 'rgba(0,0,0,0)', margin: { t: 8, r: 36, b: 40, l: 48 }, modebar: { orientation: 'v', bgcolor: 'rgba(0,0,0,0)', color: quiet, activecolor: ink }, showlegend: false, hovermode: 'closest',
      xaxis: { ...axis, ...figure.layout.xaxis }, yaxis: { ...axis, ...figure.layout.yaxis } };
    drawLegend(place, traces);
    Plotly.react(place, traces, layout, { responsive: true, displaylogo: false, modeBarButtonsToRemove: ['select2d', 'lasso2d'] });
  }
}

function openRun() {
  if (!location.hash.startsWith('#run-')) return;
  const run = document.querySelector(location.hash);
  if (run) run.open = true;
}

document.addEventListener('click', (event) => {
  const button = event.target.closest('th button');
  if (button) sortTable(button.parentElement);
});
document.addEventListener('DOMContentLoaded', () => { drawPlots(); openRun(); });
window.addEventListener('hashchange', openRun);
window.addEventListener('beforeprint', () => {
  for (const place of document.querySelectorAll('.plot')) Plotly.relayout(place, { width: 640, height: 300 });
});
window.addEventListener('afterprint', () => {
  for (const place of document.querySelectorAll('.plot')) Plotly.relayout(place, { width: null, height: null, autosize: true });
});
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', drawPlots);
