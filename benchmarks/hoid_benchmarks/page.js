'use strict';
function cellValue(row, column) {
  const text = row.cells[column].dataset.value ?? row.cells[column].textContent;
  const number = Number.parseFloat(text);
  return Number.isNaN(number) ? text : number;
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
    if (typeof x === typeof y) return x.localeCompare(y);
    return typeof x === 'number' ? -1 : 1;
  });
  if (descending) rows.reverse();
  table.tBodies[0].append(...rows);
}
function drawPlots() {
  const dark = matchMedia('(prefers-color-scheme: dark)').matches;
  const style = getComputedStyle(document.documentElement);
  const ink = style.getPropertyValue('--ink'), line = style.getPropertyValue('--line');
  for (const place of document.querySelectorAll('.plot')) {
    const figure = JSON.parse(place.nextElementSibling.textContent);
    const axis = { gridcolor: line, zerolinecolor: line, automargin: true };
    const layout = Object.assign({ paper_bgcolor: 'rgba(0,0,0,0)', plot_bgcolor: 'rgba(0,0,0,0)', font: { color: ink },
      margin: { t: 40, r: 10 }, legend: { orientation: 'h', y: -0.25 } }, figure.layout);
    layout.xaxis = Object.assign({}, axis, figure.layout.xaxis);
    layout.yaxis = Object.assign({}, axis, figure.layout.yaxis);
    Plotly.react(place, figure.data, layout, { responsive: true, displaylogo: false });
    place.dataset.theme = dark ? 'dark' : 'light';
  }
}
document.addEventListener('click', (event) => {
  const button = event.target.closest('th button');
  if (button) sortTable(button.parentElement);
});
document.addEventListener('DOMContentLoaded', drawPlots);
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', drawPlots);
