// Search runs in a worker, and browsers start none for a page that was opened from disk: there its script runs in a
// hidden frame. The theme knows this file by its name.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    #frame = document.createElement("iframe");
    #inside = new Promise((found) => {
      this.#frame.onload = () => found(this.#frame.contentWindow);
    });

    constructor(url) {
      super();
      this.#inside.then((inside) => {
        inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      });
      const script = document.createElement("script");
      script.src = new URL(url, location.href);
      this.#frame.hidden = true;
      this.#frame.srcdoc = script.outerHTML;
      document.body.append(this.#frame);
    }

    async postMessage(data) {
      const inside = await this.#inside;
      inside.dispatchEvent(new inside.MessageEvent("message", { data }));
    }
  };
}
