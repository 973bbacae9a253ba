// The time line of a recording: a slider over its frames, one frame back, and following a growing file.

import { $, onKeys, state } from "./common.js";
import { paced } from "./edits.js";
import { send, takers } from "./connection.js";

let last = 0, dragged = false;
const line = $("timeline"), seek = paced((index) => send({ do: "seek", index }));
const back = () => { if (state.timeline?.index) send({ do: "seek", index: state.timeline.index - 1 }); };
const follow = () => { if (state.timeline) send({ do: "follow", value: !state.timeline.follow }); };

line.addEventListener("input", () => { dragged = true; seek(+line.value); });
line.addEventListener("change", () => { dragged = false; });
$("back").addEventListener("click", back);
$("follow").addEventListener("click", follow);

onKeys((key, event) => {
  const keys = { ",": back, l: follow };
  if (!event.target.closest?.("input")) Object.assign(keys, { Home: () => seek(0), End: () => seek(last) });
  return state.timeline && Object.hasOwn(keys, key) ? keys[key] : null;
});

takers.scene.push(({ recording }) => {
  document.documentElement.dataset.source = recording ? "recording" : "simulation";
});
takers.timeline.push((message) => {
  state.timeline = message;
  last = message.count - 1;
  line.max = Math.max(last, 1);
  line.disabled = last === 0;
  if (!dragged) line.value = message.index;
  const text = `${(message.index + 1).toLocaleString("en")} of ${message.count.toLocaleString("en")}`;
  $("timeline-text").textContent = text;
  line.setAttribute("aria-valuetext", text);
  $("back").disabled = message.index === 0;
  $("follow").setAttribute("aria-pressed", message.follow);
});
