// Compare: a stretch of data held against the model, what is missing, adding it, taking it back.
import { T, cards, digits, download, el, getJson, percent, post, say, table, upload, withSd } from "./dom.js";
import { columnForm } from "./columns.js";
import { Plot } from "./plots.js";
import { FormulaBox } from "./formula.js";
import { sideBySide, versions } from "./versions.js";

const STRETCHES_S = [20, 60, 180];
const LONGEST_S = 300;
const PAST_S = 3600;
const PAST_POINTS = 300;
const POLL_MS = 300;
const W = T.compare;

const SURE = 0.5; // below this probability another cause is as likely as the one named

export class CompareView {
  constructor(drive, session, [wish] = []) {
    this.name = drive;
    this.session = session;
    this.wish = wish;
    this.plots = [];
    this.closed = false;
    this.asked = { seconds: STRETCHES_S[0] };
    this.data = el("select", { id: "data", onchange: () => this.chosen() });
    this.go = el("button", { className: "main", id: "go", type: "submit" }, W.go);
    this.undo = el("button", { type: "button", id: "undo", disabled: true, onclick: () => this.takeBack() }, W.undo);
    this.report = el("button", { type: "button", id: "report", disabled: true, onclick: () => this.start("/api/report", {}) }, W.report);
    this.from = el("input", { id: "from", type: "datetime-local", step: 1 });
    this.length = el("input", { id: "length", type: "number", min: 1, max: LONGEST_S, value: 20, step: "any" });
    this.past = new Plot(T.plot.past, { id: "past", x: T.axis.time, y: T.axis.torque, lines: [T.line.rms, T.line.peak], time: true, onSelect: (from, to) => this.choose(from, to) });
    this.stretch = el("div", { hidden: true }, el("div", { className: "row" }, el("label", {}, W.from, this.from), el("label", {}, W.length, this.length)), this.past.node);
    this.columns = el("section", { id: "columns", hidden: true });
    this.file = el("input", { id: "file", type: "file", accept: ".csv,.parquet", disabled: !session.allow_changes, onchange: () => this.send() });
    this.live = el("span", { className: "big", id: "live-error" }, "–");
    this.bar = el("progress", { max: 1, value: 0, "aria-label": W.working });
    this.words = el("span", {});
    this.work = el("p", { className: "row", id: "work", hidden: true, role: "status" }, this.bar, this.words);
    this.note = el("p", { id: "note", role: "alert" });
    this.lineage = new Plot(T.plot.lineage, { id: "lineage", x: T.axis.step, y: T.axis.error, lines: [T.line.lineage], whole: true });
    this.lineage.node.hidden = true;
    this.board = el("div");
    this.beside = el("div");
    this.shared = el("p", { className: "warn", id: "shared", hidden: true });
    this.trials = [];
    this.found = el("div", { id: "found" }, el("p", { className: "quiet" }, W.none));
    const form = el("form", { className: "row", onsubmit: (event) => this.look(event) }, el("label", {}, W.data, this.data), this.go, this.undo, this.report, el("label", {}, W.upload, this.file));
    this.node = el("div", {}, el("h2", {}, W.heading(drive)), el("p", {}, `${W.live}: `, this.live),
      session.allow_changes ? null : el("p", { className: "quiet" }, T.changesOff), el("section", { className: "card" }, form, this.shared, this.columns, this.stretch), this.work, this.note, this.lineage.node, this.found, this.own(), this.board, this.beside);
    this.begin();
  }

  /** What runs or was found; with the wish `find` a look is taken at once. */
  async begin() {
    await this.choices();
    await this.resume();
    if (this.wish !== "find" || this.closed || !this.work.hidden) return;
    history.replaceState(null, "", `#/compare/${encodeURIComponent(this.name)}`);
    await this.lookAt();
  }

  own() {
    this.ownName = el("input", { id: "own-name", value: "my_effect", pattern: "[a-z][a-z0-9_]*", required: true });
    this.ownText = el("input", { id: "own-formula", size: 48, maxLength: 300, required: true, autocomplete: "off", spellcheck: false });
    const ask = (path) => () => this.ownForm.reportValidity() && this.extend(path, this.ownName.value, this.ownText.value, this.ownForm);
    this.ownForm = el("form", { className: "row", onsubmit: (event) => { event.preventDefault(); ask("/api/try")(); } },
      el("label", {}, W.name, this.ownName), el("label", {}, W.formula, this.ownText),
      el("button", { id: "own-try" }, W.tryIt), el("button", { type: "button", id: "own-add", disabled: !this.session.allow_changes, onclick: ask("/api/add") }, W.add));
    this.box = new FormulaBox(this.ownText);
    this.names = el("p", { className: "row", id: "channels" });
    return el("section", { className: "card" }, el("h2", {}, W.own), this.ownForm, this.box.list, this.box.word, this.names);
  }

  async choices() {
    const { recordings, versions: rows, newest_s, upload: most, shared } = await getJson(`/api/bench?drive=${encodeURIComponent(this.name)}`);
    const kept = this.data.value;
    this.mostBytes = most;
    this.shared.hidden = !shared.length;
    say(this.shared, T.shared(shared.join(", ")));
    this.newest_s = newest_s;
    const stored = [...STRETCHES_S.map((s) => el("option", { value: `last:${s}` }, W.last(s))), el("option", { value: "part:" }, W.part)];
    this.data.replaceChildren(...stored, ...recordings.map((name) => el("option", { value: `file:${name}` }, name)));
    if (kept) this.data.value = kept;
    this.rows = rows;
    this.undo.disabled = !(rows.some((row) => row.change) && this.session.allow_changes);
    this.showVersions();
  }

  /** A stretch by its time: shown over the last hour's load, to be dragged over or typed. */
  async chosen() {
    this.stretch.hidden = this.data.value !== "part:";
    if (this.stretch.hidden) return;
    const until_s = this.newest_s ?? Date.now() / 1000;
    if (!this.from.value) this.choose(until_s - 30, until_s - 10);
    try {
      const query = `drive=${encodeURIComponent(this.name)}&names=torque_rms,torque_peak&since_s=${until_s - PAST_S}&until_s=${until_s}&points=${PAST_POINTS}`;
      const { time_s, value } = await getJson(`/api/trend?${query}`);
      if (time_s.length) this.past.set([time_s, value.torque_rms, value.torque_peak], W.drag(LONGEST_S), [time_s[0], until_s]);
      else this.past.empty(T.trendEmpty);
    } catch (error) {
      this.past.empty(error.message);
    }
  }

  choose(from_s, to_s) {
    this.from.value = new Date(1000 * Math.round(from_s)).toISOString().slice(0, 19);
    this.length.value = Math.min(Math.max(1, Math.round(to_s - from_s)), LONGEST_S);
  }

  async send() {
    const [file] = this.file.files;
    if (!file) return;
    say(this.note, "");
    if (file.size > this.mostBytes) {
      this.fail(W.tooLarge(Math.floor(this.mostBytes / 2 ** 20)));
      return;
    }
    try {
      this.working(W.sending(file.name));
      const { recording } = await upload(file);
      await this.choices();
      this.data.value = `file:${recording}`;
      await this.chosen();
      this.note.className = "";
      say(this.note, W.uploaded(recording));
      await this.askColumns(recording);
    } catch (error) {
      this.fail(error.message);
    }
    this.file.value = "";
    this.busy(false);
  }

  /** What the columns of an upload are, where their names do not say it. */
  async askColumns(name) {
    const found = await getJson(`/api/columns?name=${encodeURIComponent(name)}`);
    this.columns.hidden = found.ready;
    if (!found.ready) this.columns.replaceChildren(columnForm(found, (columns) => this.nameColumns(name, columns)));
  }

  async nameColumns(name, columns) {
    try {
      await post("/api/columns", { name, columns });
      this.columns.hidden = true;
      this.note.className = "";
      say(this.note, W.uploaded(name));
    } catch (error) {
      this.fail(error.message);
    }
  }

  /** Channel names, to be put where the formula is being written. */
  offerNames(channels) {
    if (this.names.childElementCount || !channels?.length) return;
    this.box.channels = [...new Set([...this.box.channels, ...channels])];
    this.names.replaceChildren(el("span", { className: "quiet" }, T.insert), ...channels.map((name) => el("button", { type: "button", className: "name", onclick: () => this.box.put(name) }, name)));
  }

  drive(news) {
    this.offerNames(news.picture?.channels);
    const error = news.estimates.model_nrmse?.value ?? null;
    const floor = news.estimates.model_noise_floor?.value ?? null;
    say(this.live, error === null ? "–" : `${percent(error)} %`);
    this.live.dataset.value = error ?? "";
    this.live.title = floor === null ? "" : `${T.line.floor}: ${percent(floor)} %`;
    if (!this.lineage.data && news.picture) this.showLineage(news.picture.model.lineage);
  }

  async resume() {
    const { job } = await getJson("/api/job");
    if (!job || job.drive !== this.name) return;
    if (job.running) await this.follow(job);
    else if (job.kind === "look" && !job.error) await this.showResult();
  }

  async look(event) {
    event.preventDefault();
    const [kind, which] = [this.data.value.slice(0, 4), this.data.value.slice(5)];
    if (kind === "part" && !(this.from.value && this.length.reportValidity())) return;
    const seconds = Number(this.length.value);
    this.asked = { last: { seconds: Number(which) }, file: { recording: which }, part: { seconds, until_s: Date.parse(`${this.from.value}Z`) / 1000 + seconds } }[kind];
    await this.lookAt();
  }

  lookAt() {
    this.forget();
    this.trials = [];
    return this.start("/api/look", this.asked);
  }

  extend(path, effect, expression = null, near = null, without = false) {
    this.home(near);
    this.wanted = { effect, expression, without };
    return this.start(path, { effect, ...(expression ? { expression } : {}), ...(without ? { without } : {}) });
  }

  async start(path, body) {
    say(this.note, "");
    try {
      await this.follow(await post(path, { drive: this.name, ...body }));
    } catch (error) {
      this.fail(error.message);
    }
  }

  fail(text) {
    this.note.className = "bad";
    say(this.note, text);
    this.busy(false);
  }

  /** What stands below is of other data or of another model: away with it. */
  forget() {
    this.closePlots();
    this.compared = false;
    this.report.disabled = true;
    this.home();
    this.beside.replaceChildren();
    this.found.replaceChildren(el("p", { className: "quiet" }, W.none));
  }

  /** Progress and answers stand beside what was pressed; without that at the top. */
  home(near = null) {
    (near ?? this.stretch.parentNode).after(this.work, this.note);
  }

  working(text) {
    this.busy(true);
    this.bar.removeAttribute("value");
    say(this.words, text);
  }

  busy(now) {
    this.work.hidden = !now;
    this.report.disabled = now || !this.compared;
    this.node.querySelectorAll("button.add, button.try, #go, #own-try").forEach((button) => {
      button.disabled = now || (button.classList.contains("add") && !this.session.allow_changes);
    });
  }

  async follow(job) {
    this.busy(true);
    while (job.running && !this.closed) {
      this.bar.value = job.share;
      say(this.words, `${W.working}: ${job.words}`);
      await new Promise((done) => setTimeout(done, POLL_MS));
      job = (await getJson("/api/job")).job;
    }
    this.busy(false);
    if (this.closed) return;
    if (job.error) this.fail(job.error);
    else if (job.kind === "report") download("/api/report");
    else await this.showResult();
    await this.choices();
    if (job.kind === "add" && !job.error) await this.follow(await post("/api/look", { drive: this.name, ...this.asked }));
  }

  async showResult() {
    const { job, result } = await getJson("/api/result");
    if (job.kind === "look") this.showLook(result);
    else if (job.kind === "between") {
      this.beside.replaceChildren(sideBySide(result, (key) => this.titles(key)));
      return;
    } else {
      this.note.className = "";
      this.note.dataset.after = result.after.nrmse;
      const { effect, expression, without } = this.wanted ?? { effect: result.effect, expression: null, without: false };
      say(this.note, W.done(job.kind, effect, percent(result.before.nrmse), percent(result.after.nrmse), without));
      this.trials = this.trials.filter((row) => row.effect !== effect || row.expression !== expression || row.without !== without);
      if (job.kind === "try") this.trials.push({ effect, expression, without, nrmse: result.after.nrmse });
    }
    if (job.kind !== "try") {
      this.versions = { lineage: result.lineage, effects: result.effects };
      this.showLineage(result.lineage);
    }
    this.showVersions();
  }

  showVersions() {
    if (!this.rows?.length) return;
    const { lineage, effects } = this.versions ?? { lineage: [], effects: [] };
    this.board.replaceChildren(versions({ rows: this.rows, lineage, effects, nrmse: this.newest ?? null, trials: this.trials, may: this.session.allow_changes, compared: this.compared, act: (what, row) => this.act(what, row) }));
  }

  titles(key) {
    const row = this.rows.find((one) => one.key === key);
    return row?.name || (key === "now" ? T.versions.now : T.versions.before(row?.change ?? key));
  }

  act(what, row) {
    if (what === "undo") return this.takeBack();
    if (what === "between") return this.startBetween(row);
    if (what === "name") return this.version({ do: "keep", name: row.name }, T.versions.named(row.name));
    if (what === "unname") return this.version({ do: "forget", name: row.name }, T.versions.forgotten(row.name));
    if (what === "restore") return this.version({ do: "restore", key: row.key }, T.versions.restored(this.titles(row.key)), true);
    if (what === "forget") {
      this.trials = this.trials.filter((one) => one !== row);
      return this.showVersions();
    }
    return this.extend(what === "try" ? "/api/try" : "/api/add", row.effect, row.expression, this.board, row.without);
  }

  showLineage(versions) {
    const errors = versions.map((row) => 100 * row.nrmse);
    const words = errors.length > 1 ? `${W.lineage(digits(errors[0]), digits(errors.at(-1)))} ${versions.map((row) => row.change).join(" → ")}` : W.noLineage;
    this.lineage.set([errors.map((_, i) => i), errors], words);
    this.lineage.node.dataset.versions = errors.length;
    this.lineage.node.hidden = errors.length < 2;
  }

  showLook({ compare, diagnose, plots, effects }) {
    this.closePlots();
    this.home();
    this.compared = true;
    this.report.disabled = false;
    const { nrmse, noise_floor_nrmse: floor } = compare.error;
    const error = W.error(percent(nrmse), percent(floor), floor ? digits(nrmse / floor) : "–");
    const where = table(W.whereHead, compare.where.slice(0, 6).map((row) => [row.axis, `${percent(row.share, 2)} %`, row.detail]));
    const parameters = cards(W.parametersHead, compare.parameters.map((row) => [row.effect, row.name, ...withSd(row.value, row.sd), row.unit, row.identified ? W.yes : row.advice]));
    const next = diagnose.next_experiment;
    const guess = diagnose.verdict === "missing" && diagnose.candidates[0].probability < SURE;
    const card = (heading, ...parts) => el("section", { className: "card" }, el("h2", {}, heading), ...parts);
    const folded = (words, part) => el("details", { className: "card" }, el("summary", {}, words), part);
    const adequate = diagnose.verdict === "adequate";
    const places = [el("p", { className: "quiet" }, W.overlap), where];
    this.found.replaceChildren(
      el("section", { className: `state ${adequate ? "good" : "warn"}` }, el("div", {}, el("b", { id: "verdict", "data-verdict": diagnose.verdict, "data-nrmse": nrmse }, W.verdict[guess ? "guess" : diagnose.verdict]), el("p", {}, error), el("p", { className: "quiet" }, W.effects(effects.join(", "))))),
      ...[...new Set([...compare.warnings, ...(diagnose.warnings ?? [])])].map((line) => el("p", { className: "warn" }, line)),
      ...(diagnose.candidates.length ? [card(W.candidates, this.candidates(diagnose.candidates), ...(next ? [el("p", {}, W.next(next.separates.join(", "), next.motion))] : []))] : []),
      ...(diagnose.proposals?.length ? [card(W.proposals, this.proposals(diagnose.proposals, effects))] : []),
      ...(adequate || !compare.where.length ? [] : [card(W.where, ...places)]),
      this.pictures(plots, compare.where, nrmse), folded(W.parameters, parameters),
    );
    this.newest = nrmse;
    this.plots.forEach((plot) => plot.draw(true));
  }

  candidates(rows) {
    const act = (path, effect, word, of, className) => el("button", { type: "button", className, "aria-label": of(effect), "data-effect": effect, disabled: className === "add" && !this.session.allow_changes, onclick: (event) => this.extend(path, effect, null, event.target.closest("section")) }, word);
    const buttons = (effect) => el("span", {}, act("/api/add", effect, W.add, W.addOf, "add"), " ", act("/api/try", effect, W.tryIt, W.tryOf, "try"));
    const line = (row) => [row.effect, percent(row.nrmse_after), row.probability < 0.005 ? W.hardly : digits(row.probability, 2), row.confused_with.join(", ") || "–", buttons(row.effect)];
    const none = Math.max(0, 1 - rows.reduce((sum, row) => sum + row.probability, 0));
    const shown = rows.filter((row, i) => i === 0 || row.probability >= 0.005);
    const others = rows.filter((row) => !shown.includes(row)).slice(0, 6);
    const table = cards(W.candidatesHead, [...shown.map(line), [W.neither, "", none < 0.005 ? W.hardly : digits(none, 2), "", ""]]);
    return el("div", {}, table, others.length ? el("details", {}, el("summary", {}, W.others(others.length)), cards(W.candidatesHead, others.map(line))) : "");
  }

  /** Formulas for what no effect of the catalogue explains: tried or added under a name that is free. */
  proposals(rows, effects) {
    const name = ["law", ...effects.map((_, i) => `law_${i + 2}`)].find((one) => !effects.includes(one));
    const button = (row, path, word, className) => el("button", { type: "button", className, "data-expression": row.expression, disabled: className === "add" && !this.session.allow_changes, onclick: () => this.extend(path, name, row.expression) }, word);
    return cards(W.proposalsHead, rows.slice(0, 4).map((row) => [row.expression, row.reads, percent(row.nrmse_after), row.probability < 0.005 ? W.hardly : digits(row.probability, 2),
      el("span", {}, button(row, "/api/try", W.tryIt, "try"), " ", button(row, "/api/add", W.add, "add"))]));
  }

  pictures(plots, where, nrmse) {
    const nodes = [];
    const keep = (plot, control = null) => {
      this.plots.push(plot);
      if (control) plot.verdict.before(control);
      nodes.push(plot.node);
    };
    if (plots.side_by_side) {
      const s = plots.side_by_side;
      const sides = new Plot(T.plot.sides, { id: "sides", x: T.axis.seconds, y: `${T.axis.torque.split(" [")[0]} [${plots.unit}]`, lines: [T.line.measured, T.line.modelled, T.line.residual] });
      sides.set([s.time_s, s.measured, s.modelled, s.residual], W.sides(percent(nrmse)));
      keep(sides);
    }
    if (plots.residual.length) keep(...this.residual(plots, where));
    if (plots.spectra.length) keep(...this.spectrum(plots));
    return el("div", { className: "plots" }, ...nodes);
  }

  residual(plots, where) {
    const shares = Object.fromEntries(where.map((row) => [row.axis, row.share]));
    const plot = new Plot(T.plot.residual, { id: "residual", x: "", y: T.axis.residual(plots.unit), lines: [T.line.mean, "+ sd", "− sd"], band: [1, 2] });
    const choose = (axis) => {
      const row = plots.residual.find((one) => one.axis === axis);
      plot.x = `${axis} [${row.unit}]`;
      plot.set([row.at, row.mean, row.high, row.low], W.residual(axis, percent(shares[axis], 2)));
      plot.draw(true);
    };
    const control = select(W.axis, "axis", plots.residual.map((row) => row.axis), choose);
    choose(plots.residual[0].axis);
    return [plot, control];
  }

  spectrum(plots) {
    const plot = new Plot(T.plot.spectrum, { id: "spectrum", x: "", y: T.axis.amplitude(plots.unit), lines: [T.line.residual], logY: true });
    const choose = (axis) => {
      const row = plots.spectra.find((one) => one.axis === axis);
      const peak = row.amplitude.indexOf(Math.max(...row.amplitude));
      plot.x = axis === "frequency" ? T.axis.frequency : `${axis} [1]`;
      plot.set([row.at, row.amplitude.map((value) => (value > 0 ? value : null))], W.peak(`${digits(row.at[peak])}${axis === "frequency" ? " Hz" : ""}`));
      plot.draw(true);
    };
    const control = select(W.order, "order", plots.spectra.map((row) => row.axis), choose);
    choose(plots.spectra[0].axis);
    return [plot, control];
  }

  takeBack() {
    return this.version({ do: "undo" }, W.undone(this.rows?.findLast((row) => row.change)?.change ?? ""), true);
  }

  /** Undo, name, forget or restore; where the model in force is another afterwards, what stands here is of the old one. */
  async version(what, words, other = false) {
    try {
      await post("/api/version", { drive: this.name, ...what });
      if (other) this.forgetModel();
      this.home(this.board);
      this.note.className = "";
      say(this.note, words);
      await this.choices();
    } catch (error) {
      this.fail(error.message);
    }
  }

  forgetModel() {
    this.lineage.data = null;
    this.versions = null;
    this.newest = null;
    this.forget();
  }

  startBetween(keys) {
    this.home(this.board);
    return this.start("/api/between", { versions: keys });
  }

  closePlots() {
    this.plots.forEach((plot) => plot.close());
    this.plots = [];
  }

  close() {
    this.closed = true;
    this.closePlots();
    this.lineage.close();
    this.past.close();
  }
}

function select(label, id, names, choose) {
  const control = el("select", { id, onchange: () => choose(control.value) }, ...names.map((name) => el("option", {}, name)));
  return el("label", {}, label, control);
}
