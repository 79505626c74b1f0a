// In tables short names and numbers do not break, long names do after a slash or a bar. Tables of numbers sort by the column
// that is clicked, by its first number where it has one.
{
  const value = cell => { const found = cell.textContent.match(/-?\d+(\.\d+)?/); return found ? Number(found[0]) : NaN }
  const compare = (a, b) => {
    const [x, y] = [value(a), value(b)]
    if (/^[-\d.]/.test(a.textContent + b.textContent) && !(isNaN(x) && isNaN(y))) return isNaN(x) - isNaN(y) || x - y
    return a.textContent.localeCompare(b.textContent)
  }
  for (const code of document.querySelectorAll('.md-typeset td code')) if (code.textContent.length < 28) code.dataset.short = ''
  for (const cell of document.querySelectorAll('.md-typeset td')) {
    if (cell.textContent.length < 13) cell.dataset.short = ''
    const texts = document.createTreeWalker(cell, NodeFilter.SHOW_TEXT)
    for (let text = texts.nextNode(); text; text = texts.nextNode())
      for (let at; (at = text.data.search(/[/|]\S/)) >= 0; text = texts.nextNode()) text.splitText(at + 1).before(document.createElement('wbr'))
  }
  for (const table of document.querySelectorAll('.md-typeset table')) {
    const rows = [...table.tBodies[0].rows], heads = [...table.tHead.rows[0].cells]
    if (heads.length < 5 || !rows.some(row => [...row.cells].filter(cell => /^[-\d.]+\s?[\d.%[]*/.test(cell.textContent)).length > 1)) continue
    table.dataset.numbers = ''
    heads.forEach((head, k) => head.addEventListener('click', () => {
      const up = head.getAttribute('aria-sort') !== 'ascending'
      heads.forEach(other => other.removeAttribute('aria-sort'))
      head.setAttribute('aria-sort', up ? 'ascending' : 'descending')
      rows.sort((a, b) => (up ? 1 : -1) * compare(a.cells[k], b.cells[k]))
      table.tBodies[0].append(...rows)
    }))
  }
}
