// A view inside a notebook: the page in a frame of its own, so that neither its keys nor its style reach the notebook.
// Its messages go through the notebook's connection to Python. PAGE is the page as one text: viewer/notebook.py adds it.

export default {
  render({ model, el }) {
    const frame = document.createElement("iframe");
    Object.assign(frame, { title: "mpsim", srcdoc: PAGE, allow: "clipboard-write; fullscreen" });
    frame.style.cssText = `display: block; width: 100%; height: ${model.get("height")}px; border: 0;`;
    let page = null, port = null;

    const close = () => { if (page) model.send({ page, close: true }); };
    /** Each time that the page is loaded, as it is when a notebook moves it, it is another page. */
    const open = () => {
      close();
      port?.close();
      const channel = new MessageChannel();
      [page, port] = [crypto.getRandomValues(new Uint32Array(2)).join("-"), channel.port1];
      const own = page;
      port.onmessage = ({ data }) => model.send({ page: own, text: data });
      frame.contentWindow.postMessage({ mpsim: "port" }, "*", [channel.port2]);
      model.send({ page, open: true });
    };
    const ready = (event) => { if (event.source === frame.contentWindow && event.data?.mpsim === "ready") open(); };
    const take = (content, buffers) => {
      if (content.page !== page) return;
      if (content.ping) { model.send({ page, pong: true }); return; } // here, as a hidden page answers late
      if (content.bytes) {
        const { buffer, byteOffset, byteLength } = buffers[0], copy = buffer.slice(byteOffset, byteOffset + byteLength);
        port.postMessage(copy, [copy]);
      } else port.postMessage(content.text ?? content);
    };
    addEventListener("message", ready);
    model.on("msg:custom", take);
    el.append(frame);
    return () => {
      removeEventListener("message", ready);
      model.off("msg:custom", take);
      close();
    };
  },
};
