// The connection to the run, and what is asked of it. It works where the plots fail.
"use strict";
(() => {
  const SILENT_MS = 2000, PATIENCE_MS = 3000, ATTEMPTS = 5;
  const get = (id) => document.getElementById(id), token = location.hash.slice(1);
  const controls = document.body.classList.contains("control"), buttons = ["estop", "stop", "start", "set"].map(get);
  const last = controls ? " Use the device's own emergency stop." : "";
  let events = null, heard = Date.now(), time = null, ended = false;

  const say = (text, bad) => { get("answer").textContent = text; get("answer").className = bad ? "bad" : "dim"; };
  const stateOf = (text, colour) => { get("source").textContent = text; get("source").style.background = `var(--${colour})`; };

  const take = (m) => {
    if (m.t_s !== time) { time = m.t_s; heard = Date.now(); } // a run that stands still repeats its last sample
    stateOf(m.source.toUpperCase(), m.source === "mpc" ? "good" : m.source === "stop" ? "bad" : "dim");
    get("start").disabled = !token || m.source !== "await start";
    try { window.draw(m); } catch (error) { get("link").hidden = false; get("link").textContent = `The plots and figures fail, the buttons work: ${error.message}`; }
  };
  const finish = () => {
    const stopped = get("source").textContent === "STOP";
    ended = true;
    events.close();
    stateOf(stopped ? "STOPPED" : "ENDED", stopped ? "bad" : "dim");
    get("link").hidden = true;
    for (const button of buttons) button.disabled = true;
  };
  const listen = () => {
    if (ended) return;
    events = new EventSource("/events");
    events.onmessage = (event) => take(JSON.parse(event.data));
    events.addEventListener("end", finish);
  };

  const ask = async (path, body) => { // whether the run does it
    events.close(); // a browser has six connections for all its tabs: this one is needed now
    const end = new AbortController(), timer = setTimeout(() => end.abort(), PATIENCE_MS);
    try {
      const answer = await fetch(path, { method: "POST", body, signal: end.signal, headers: { Authorization: `Bearer ${token}` } });
      const text = await answer.text(), name = path === "/estop" ? "E-STOP" : path.slice(1);
      say(`${name}${answer.ok ? " taken" : " not done"}${text && ": "}${text}`, !answer.ok);
      return answer.ok;
    } catch {
      say(`${path.slice(1)}: the run could not be reached.${last}`, true);
      return false;
    } finally {
      clearTimeout(timer);
      listen();
    }
  };
  const emergency = async () => {
    for (let k = 0; k < ATTEMPTS; k++) if (await ask("/estop")) return;
    say(`E-STOP NOT CONFIRMED.${last}`, true);
  };

  get("estop").onclick = emergency;
  get("stop").onclick = () => ask("/stop");
  get("start").onclick = () => ask("/start");
  get("target").onsubmit = (event) => { event.preventDefault(); ask("/target", JSON.stringify({ deg: get("deg").valueAsNumber })); };
  const { low, high } = document.body.dataset;
  if (low && high) get("range").textContent = `${(+low).toFixed(1)} to ${(+high).toFixed(1)} deg`;
  if (controls && !token) {
    for (const button of buttons) button.disabled = true;
    say("Only to look at: the address that the terminal shows has a token behind #.", true);
  }
  setInterval(() => {
    if (ended) return;
    if (events.readyState === EventSource.CLOSED) listen(); // turned away
    const silent = Date.now() - heard;
    if (silent < SILENT_MS) { if (get("link").textContent.startsWith("NO")) get("link").hidden = true; return; }
    stateOf("NO DATA", "bad");
    get("link").hidden = false;
    get("link").textContent = `NO DATA from the run for ${Math.floor(silent / 1000)} s. What you see is old.${last}`;
  }, 500);
  listen();
})();
