// Asks how the cell stands, and puts in place what has changed; a server that is silent is said to be.
const asked = document.querySelector("[data-revision]");
const status = document.getElementById("status");
const ageOf = seconds => seconds < 120 ? `${Math.round(seconds)} s` : `${Math.round(seconds / 60)} min`;

async function renew(revision) {
  const answer = await fetch("./");
  const page = new DOMParser().parseFromString(await answer.text(), "text/html");
  for (const fresh of page.querySelectorAll("[data-part]")) {
    const shown = document.getElementById(fresh.id);
    if (!shown) return location.reload();
    if (shown.innerHTML !== fresh.innerHTML) shown.replaceChildren(...fresh.childNodes);
  }
  asked.dataset.revision = revision;
}

async function look() {
  try {
    const cell = await (await fetch("state", {signal: AbortSignal.timeout(10000)})).json();
    if (cell.revision !== asked.dataset.revision) await renew(cell.revision);
    const age = document.getElementById("age");
    if (age && cell.monitor) age.textContent = ageOf(cell.monitor.age_s);
    status.textContent = "";
  } catch {
    if (!status.textContent) {
      status.textContent = `The server has not answered since ${new Date().toLocaleTimeString()}; what is below may be old.`;
    }
  }
  setTimeout(look, 2000);
}
setTimeout(look, 2000);
