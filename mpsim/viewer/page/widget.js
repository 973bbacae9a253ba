// A view in a notebook: the page in an iframe of its own, so that its keys and style do not affect the notebook.
// Its messages use the notebook's connection to Python. PAGE is the page as one text; viewer/server.py adds it.

const QUIET = 30000; // ms without a message after which one was lost: a ping comes every 10 s

export default {
  render({ model, el }) {
    const frame = document.createElement("iframe");
    Object.assign(frame, { title: "mpsim", srcdoc: PAGE, allow: "clipboard-write; fullscreen" });
    frame.style.cssText = `display: block; width: 100%; height: ${model.get("height")}px; border: 0;`;
    let page = null, port = null, opened = false, received = 0, heard = 0;

    const say = (content) => {
      try { model.send({ page, ...content }); } catch { // the kernel has ended, or was restarted
        clearInterval(asking);
        port?.postMessage({ quiet: true });
      }
    };
    const close = () => { if (page) say({ close: true }); };
    /** Each load, as when the notebook moves the output, counts as a new page. */
    const open = () => {
      close();
      port?.close();
      const channel = new MessageChannel();
      [page, port] = [crypto.getRandomValues(new Uint32Array(2)).join("-"), channel.port1];
      [opened, received, heard] = [false, 0, Date.now()];
      const own = page;
      port.onmessage = ({ data }) => say({ page: own, ...data });
      frame.contentWindow.postMessage({ mpsim: "port" }, "*", [channel.port2]);
      say({ open: true });
    };
    const ready = (event) => { if (event.source === frame.contentWindow && event.data?.mpsim === "ready") open(); };
    const take = (content, buffers) => {
      if (content.page !== page) return;
      heard = Date.now();
      if (!opened && !content.closed) { // its message may have been lost
        opened = true;
        port.postMessage({ opened });
      }
      if (content.opened) return;
      if (content.ping) { // answered here, because a hidden page is slow
        const lost = received !== content.sent;
        say({ pong: true, lost });
        if (lost) port.postMessage({ lost });
        received = content.sent;
        return;
      }
      if (!content.closed) received += 1;
      const [bytes] = (buffers ?? []).map(({ buffer, byteOffset, byteLength }) => buffer.slice(byteOffset, byteOffset + byteLength));
      if (content.bytes) port.postMessage(bytes, [bytes]);
      else if (content.kept) port.postMessage({ ...content, bytes });
      else port.postMessage(content.text ?? content);
    };
    const asking = setInterval(() => {
      if (!page || Date.now() - heard < QUIET) return;
      heard = Date.now();
      port.postMessage({ quiet: true });
      say({ pong: true, lost: true });
    }, QUIET / 6);
    addEventListener("message", ready);
    model.on("msg:custom", take);
    el.append(frame);
    return () => {
      clearInterval(asking);
      removeEventListener("message", ready);
      model.off("msg:custom", take);
      close();
    };
  },
};
