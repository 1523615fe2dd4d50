// Follows a fit by the service's events, and shows the result when it is there.
const root = document.documentElement.dataset.root;
const { id, status } = document.getElementById("fit").dataset;

function follow() {
  const state = document.getElementById("state");
  const bar = document.getElementById("bar");
  const events = new EventSource(`${root}v1/fits/${id}/events`);
  events.addEventListener("accepted", () => { state.textContent = "Waiting for its turn"; });
  events.addEventListener("running", (event) => {
    bar.value = JSON.parse(event.data).progress;
    state.textContent = "Fitting";
  });
  for (const end of ["succeeded", "failed", "cancelled"]) {
    events.addEventListener(end, () => { events.close(); location.reload(); });
  }
  events.onerror = () => { // the browser connects again by itself, except after an answer that is no stream
    if (events.readyState === EventSource.CLOSED) setTimeout(() => location.reload(), 3000);
  };
  document.getElementById("cancel").addEventListener("click", async () => {
    const answer = await fetch(`${root}v1/fits/${id}?only=cancel`, { method: "DELETE" });
    if (answer.ok || answer.status === 409) return location.reload();
    const fault = document.getElementById("fault");
    fault.hidden = false;
    fault.textContent = (await answer.json()).detail;
  });
}

if (status === "accepted" || status === "running") follow();
