// STOP is a request of its own: it needs nothing else of the page to be well.
const stop = () => fetch("/stop", {method: "POST", keepalive: true});
const isStop = (event) => event.target.closest && event.target.closest(".stop");
const writes = (element) => element.matches("textarea, input:not([type]), input[type=text]");
addEventListener("click", (event) => { if (isStop(event)) stop(); }, true);
// before anything else hears it: no button that has the focus may take the space bar for a click
for (const kind of ["keydown", "keyup"]) {
  addEventListener(kind, (event) => {
    if (event.code !== "Space" || writes(event.target)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (kind === "keydown" && !event.repeat) stop();
  }, true);
}
