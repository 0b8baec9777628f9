// What a page can do without and a person likes: a page of jobs that asks again, and a range of time drawn with the pointer.
"use strict";

// The page of jobs asks again while something is open.
const jobs = document.querySelector("[data-poll]");
if (jobs) {
  const poll = async () => {
    const answer = await fetch(location.href, { headers: { Accept: "text/html" } });
    if (answer.ok && !jobs.contains(document.activeElement)) {
      const fresh = new DOMParser().parseFromString(await answer.text(), "text/html").querySelector("[data-poll]");
      jobs.replaceChildren(...fresh.childNodes);
      jobs.dataset.poll = fresh.dataset.poll;
    }
    if (jobs.dataset.poll === "open") setTimeout(poll, 2000);
  };
  if (jobs.dataset.poll === "open") setTimeout(poll, 2000);
}

// Drawing over a time axis asks for that range: what `data-time` says are its ends, and where they stand in the figure.
const SHORTEST = 12;
document.querySelectorAll("svg[data-time]").forEach((svg) => {
  const [first, last, left, right] = svg.dataset.time.split(" ").map(Number);
  const instant = (x) => {
    const box = svg.getBoundingClientRect(), share = ((x - box.left) / box.width - left) / (right - left);
    return new Date(1000 * (first + Math.min(Math.max(share, 0), 1) * (last - first))).toISOString().slice(0, 10);
  };
  let from = null;
  svg.addEventListener("pointerdown", (event) => { from = event.pointerType === "mouse" && event.button === 0 ? event.clientX : null; });
  svg.addEventListener("dragstart", (event) => event.preventDefault());
  window.addEventListener("pointerup", (event) => {
    if (from === null) return;
    const [since, until] = [Math.min(from, event.clientX), Math.max(from, event.clientX)];
    from = null;
    if (until - since < SHORTEST || instant(since) === instant(until)) return;
    const address = new URL(location.href);
    address.searchParams.set("since", instant(since));
    address.searchParams.set("until", instant(until));
    location.assign(address);
  });
});
