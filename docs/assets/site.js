// In tables short names and numbers do not break, long names do after a slash or a bar. Tables with a column of numbers sort
// by the header that is pressed; a column of numbers by its first number, and what has none stays at the end.
document$.subscribe(() => {
  const number = cell => cell.textContent.trim() === 'equal' ? 0 : Number(cell.textContent.match(/^\s*(-?\d+(\.\d+)?)/)?.[1] ?? NaN)
  for (const code of document.querySelectorAll('.md-typeset td code')) if (code.textContent.length < 28) code.dataset.short = ''
  for (const cell of document.querySelectorAll('.md-typeset td')) {
    if (cell.textContent.length < 13) cell.dataset.short = ''
    const texts = document.createTreeWalker(cell, NodeFilter.SHOW_TEXT)
    for (let text = texts.nextNode(); text; text = texts.nextNode())
      for (let at; (at = text.data.search(/[/|]\S/)) >= 0; text = texts.nextNode()) text.splitText(at + 1).before(document.createElement('wbr'))
  }
  for (const table of document.querySelectorAll('.md-typeset table:not([data-sorts])')) {
    const rows = [...table.tBodies[0].rows], heads = [...table.tHead.rows[0].cells]
    const ofNumbers = heads.map((_, k) => {
      const filled = rows.map(row => row.cells[k]).filter(cell => !['', '-'].includes(cell.textContent.trim()))
      return filled.filter(cell => !isNaN(number(cell))).length > filled.length / 2
    })
    if (rows.length < 3 || !ofNumbers.includes(true)) continue
    table.dataset.sorts = ''
    if (ofNumbers.filter(is => is).length > 2) table.dataset.numbers = ''
    heads.forEach((head, k) => {
      const button = document.createElement('button')
      button.append(...head.childNodes)
      head.append(button)
      button.addEventListener('click', () => {
        const sign = head.ariaSort === 'ascending' ? -1 : 1
        heads.forEach(other => { other.ariaSort = null })
        head.ariaSort = sign > 0 ? 'ascending' : 'descending'
        rows.sort((a, b) => {
          const [x, y] = [a, b].map(row => ofNumbers[k] ? number(row.cells[k]) : 0)
          const asText = a.cells[k].textContent.localeCompare(b.cells[k].textContent, 'en', {numeric: true})
          return isNaN(x) - isNaN(y) || sign * (x - y || asText)
        })
        table.tBodies[0].append(...rows)
      })
    })
  }
})
