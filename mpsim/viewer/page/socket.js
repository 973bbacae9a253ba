// The connection to mpsim: a WebSocket, or in a notebook a port to the widget, with the same interface.

export const inNotebook = document.documentElement.dataset.place === "notebook";

/** A port from the widget, with the WebSocket members that the page uses; see widget.js. */
class PortSocket {
  readyState = WebSocket.CONNECTING;

  constructor() {
    const take = (event) => {
      if (event.source !== parent || event.data?.mpsim !== "port") return;
      removeEventListener("message", take);
      [this.port] = event.ports;
      this.port.onmessage = ({ data }) => this.hear(data);
    };
    addEventListener("message", take);
    parent.postMessage({ mpsim: "ready" }, "*");
  }

  hear(data) {
    if (data.opened) {
      this.readyState = WebSocket.OPEN;
      this.onopen();
    } else if (data.closed) this.end(data.closed);
    else this.onmessage({ data });
  }

  send(text) { this.port.postMessage(text); }

  /** The code says that a rule was broken: retrying would not help. */
  end({ code, reason }) {
    this.readyState = WebSocket.CLOSED;
    this.onclose({ code, reason });
  }

  close() { if (this.readyState !== WebSocket.CLOSED) this.end({ code: 1000, reason: "" }); }
}

export function openSocket() {
  if (inNotebook) return new PortSocket();
  const address = new URL("socket", location.href);
  address.protocol = "ws:";
  address.search = address.hash = "";
  const socket = new WebSocket(address);
  socket.binaryType = "arraybuffer";
  return socket;
}
