// The connection to mpsim: a WebSocket, or in a notebook a port to the widget, with the same interface.

export const inNotebook = document.documentElement.dataset.place === "notebook";

/** A port from the widget, with the WebSocket members that the page uses; see widget.js. */
class PortSocket {
  readyState = WebSocket.CONNECTING;
  files = new Map(); // those asked for: by name, what takes the answer

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
    else if (data.kept) this.files.get(data.kept)?.(data);
    else if (data.quiet) this.onquiet();
    else if (data.lost) this.giveUp("The notebook has lost a message. Try again.");
    else this.onmessage({ data });
  }

  send(text) { this.port.postMessage({ text }); }

  async file(name) {
    this.port.postMessage({ keep: name });
    const { refused, bytes, kind } = await new Promise((take) => { this.files.set(name, take); });
    if (refused) throw new Error(refused);
    return new Blob([bytes], { type: kind });
  }

  giveUp(refused) { for (const take of this.files.values()) take({ refused }); }

  /** The code says that a rule was broken: retrying would not help. */
  end({ code, reason }) {
    this.readyState = WebSocket.CLOSED;
    this.giveUp("No connection to mpsim.");
    this.onclose({ code, reason });
  }

  close() { if (this.readyState !== WebSocket.CLOSED) this.end({ code: 1000, reason: "" }); }
}

/** A file from the simulation as a Blob; throws an Error that says why there is none. */
export async function fileFrom(socket, name) {
  const lost = new Error("No connection to mpsim.");
  if (socket?.readyState !== WebSocket.OPEN) throw lost;
  if (inNotebook) return socket.file(name);
  const answer = await fetch(`keep/${name}`).catch(() => { throw lost; });
  if (!answer.ok) throw new Error(await answer.text());
  return answer.blob();
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
