// The reference of the interface, drawn from the OpenAPI document.

const document_ = await (await fetch("/openapi.json")).json();
const made = (tag, content, className) => {
  const element = document.createElement(tag);
  if (content !== undefined) element.textContent = content;
  if (className) element.className = className;
  return element;
};
const resolved = (schema) => {
  const name = schema?.$ref?.split("/").pop();
  return name ? document_.components.schemas[name] : schema;
};

const path_streams = (path) => path.endsWith("/events"); // which does not end

// A schema's type in few words.
function typed(schema) {
  if (!schema) return "anything";
  if (schema.$ref) return schema.$ref.split("/").pop();
  const options = schema.anyOf ?? schema.oneOf;
  if (options) return options.map(typed).join(" or ");
  if (schema.enum) return schema.enum.map((value) => JSON.stringify(value)).join(" or ");
  if (schema.type === "array") return `list of ${typed(schema.items)}`;
  const range = [["minimum", "≥"], ["exclusiveMinimum", ">"], ["maximum", "≤"], ["maxLength", "length ≤"]]
    .filter(([name]) => schema[name] !== undefined).map(([name, sign]) => `${sign} ${schema[name]}`);
  return [schema.type ?? "anything", ...range].join(", ");
}

// The fields of an object, with types and meaning.
function fields(schema) {
  const list = made("ul", undefined, "fields");
  for (const [name, field] of Object.entries(resolved(schema)?.properties ?? {})) {
    const item = made("li");
    item.append(made("code", name), ` ${typed(field)}${field.description ? `: ${field.description}` : ""}`);
    list.append(item);
  }
  return list;
}

// A field for a value of a schema: a choice, a number within its limits, or text.
function field({ name, required, schema }) {
  const options = schema.enum ?? schema.anyOf?.find((each) => each.enum)?.enum ?? (schema.type === "boolean" ? [true, false] : null);
  const plain = schema.anyOf?.find((each) => each.type !== "null") ?? schema;
  const input = made(options ? "select" : "input");
  if (options) input.append(...["", ...options].map((value) => new Option(value, value)));
  else if (["integer", "number"].includes(plain.type)) {
    Object.assign(input, { type: "number", step: plain.type === "integer" ? 1 : "any", min: plain.minimum ?? "", max: plain.maximum ?? "" });
  }
  input.name = name;
  input.required = Boolean(required);
  return input;
}

// A form that asks the route, with the key of the page.
function trial({ path, method }, parameters, example) {
  const form = made("form", undefined, "try"), answer = made("pre");
  for (const parameter of parameters) {
    const label = made("label", `${parameter.name} `);
    label.append(field(parameter));
    form.append(label);
  }
  const body = example === undefined ? null : made("textarea", example);
  if (body) {
    const label = made("label", "Body ", "body");
    body.rows = Math.min(example.split("\n").length + 1, 16);
    label.append(body);
    form.append(label);
  }
  form.append(made("button", "Try"));
  answer.hidden = true;
  answer.tabIndex = 0;
  answer.setAttribute("role", "status");
  form.onsubmit = async (event) => {
    event.preventDefault();
    if (method === "delete" && !confirm(`Delete ${path}?`)) return;
    let place = path;
    const query = new URLSearchParams();
    for (const parameter of parameters) {
      const value = form.elements[parameter.name].value;
      if (parameter.in === "path") place = place.replace(`{${parameter.name}}`, encodeURIComponent(value));
      else if (value) query.set(parameter.name, value);
    }
    const key = sessionStorage.getItem("hapslam-key");
    const headers = { ...(key && { Authorization: `Bearer ${key}` }), ...(body && { "Content-Type": "application/json" }) };
    const asked = { method: method.toUpperCase(), headers, ...(body && { body: body.value }) };
    const reply = await fetch(`${place}${query.size ? `?${query}` : ""}`, asked);
    const text = await reply.text();
    answer.hidden = false;
    answer.textContent = `${reply.status}\n${text.slice(0, 5000)}`;
  };
  const box = made("div");
  box.append(form, answer);
  return box;
}

document.getElementById("title").textContent = `${document_.info.title} ${document_.info.version}`;
document.getElementById("about").textContent = document_.info.description;
const groups = new Map();
for (const [path, methods] of Object.entries(document_.paths)) {
  for (const [method, route] of Object.entries(methods)) {
    const group = route.tags?.[0] ?? "other";
    if (!groups.has(group)) groups.set(group, []);
    groups.get(group).push({ path, method, ...route });
  }
}
for (const [group, routes] of groups) {
  const section = made("section");
  section.append(made("h2", group));
  for (const route of routes) {
    const details = made("details", undefined, "route"), summary = made("summary");
    summary.append(made("code", `${route.method.toUpperCase()} ${route.path}`), ` ${route.summary ?? ""}`);
    details.append(summary, made("p", route.description ?? ""));
    for (const parameter of route.parameters ?? []) {
      if (parameter.in === "path") continue;
      const where = `${parameter.in}${parameter.required ? ", required" : ""}`;
      details.append(made("p", `${parameter.name} (${where}; ${typed(parameter.schema)}): ${parameter.description ?? ""}`));
    }
    const body = resolved(route.requestBody?.content?.["application/json"]?.schema);
    const examples = (body?.examples ?? []).map((example) => JSON.stringify(example, null, 2));
    for (const example of examples) details.append(made("pre", example));
    for (const shown of details.querySelectorAll("pre")) shown.tabIndex = 0;
    if (body) details.append(made("p", "Body:"), fields(body));
    const good = Object.entries(route.responses).find(([status]) => status.startsWith("2"))?.[1];
    const given = good?.content?.["application/json"]?.schema;
    if (given) details.append(made("p", `Answer: ${typed(given)}`), fields(given));
    const answers = Object.entries(route.responses).map(([status, answer]) => `${status} ${answer.description}`);
    details.append(made("p", `Answers: ${answers.join("; ")}.`));
    const asked = (route.parameters ?? []).filter((parameter) => parameter.in !== "header");
    const json = !route.requestBody || body;
    if (json && !path_streams(route.path)) details.append(trial(route, asked, body ? examples[0] ?? "{}" : undefined));
    section.append(details);
  }
  document.getElementById("routes").append(section);
}
