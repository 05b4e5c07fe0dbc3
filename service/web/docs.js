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
      details.append(made("p", `${parameter.name} (${parameter.in}${parameter.required ? ", required" : ""}): ${parameter.description ?? ""}`));
    }
    const body = resolved(route.requestBody?.content?.["application/json"]?.schema);
    for (const example of body?.examples ?? []) details.append(made("pre", JSON.stringify(example, null, 2)));
    if (body && !body.examples) details.append(made("pre", JSON.stringify(body, null, 2)));
    const answers = Object.entries(route.responses).map(([status, answer]) => `${status} ${answer.description}`);
    details.append(made("p", `Answers: ${answers.join("; ")}.`));
    section.append(details);
  }
  document.getElementById("routes").append(section);
}
