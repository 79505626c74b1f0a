// A browser starts no worker for a page that is opened as a file. Its script then runs in a hidden frame: so the search works.
if (location.protocol === 'file:') window.Worker = class extends EventTarget {
  constructor(url) {
    super()
    const frame = document.createElement('iframe')
    frame.hidden = true
    document.body.append(frame)
    this.window = frame.contentWindow
    this.loaded = new Promise(resolve => { this.window.resolve = resolve })
    this.window.answer = data => this.dispatchEvent(new MessageEvent('message', {data}))
    this.window.document.write(`<script>postMessage = answer</script><script src="${url}"></script><script>resolve()</script>`)
    this.window.document.close()
  }
  postMessage(data) {
    this.loaded.then(() => this.window.dispatchEvent(new MessageEvent('message', {data})))
  }
}
