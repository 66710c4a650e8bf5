// Draws a body in space as it is seen from one direction. The browser does it, so that turning waits for nobody.
// Each row of `space` is a line or a point in mm, {kind, points, look ...}; what is seen of it goes into other sources.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
const minus = (a, b) => a.map((x, i) => x - b[i])
const turned = (a, b, c) => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
const triples = flat => Array.from({length: flat.length / 3}, (_, i) => Array.from(flat.slice(3 * i, 3 * i + 3)))

// the convex hull of points in the plane
const hull = points => {
  const half = ordered => {
    const found = []
    for (const point of ordered) {
      while (found.length > 1 && turned(found.at(-2), found.at(-1), point) <= 0) found.pop()
      found.push(point)
    }
    return found.slice(0, -1)
  }
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1])
  return [...half(sorted), ...half(sorted.reverse())]
}

export default ({space, azimuth, elevation, center, ...seen}) => {
  const [around, up] = [azimuth, elevation].map(angle => (angle.value ?? angle) * Math.PI / 180)
  const right = [-Math.sin(around), Math.cos(around), 0]
  const upward = [-Math.sin(up) * Math.cos(around), -Math.sin(up) * Math.sin(around), Math.cos(up)]
  const sight = [Math.cos(up) * Math.cos(around), Math.cos(up) * Math.sin(around), Math.sin(up)]
  const flat = point => [dot(minus(point, center), right), dot(minus(point, center), upward)]

  const rows = Array.from(space.get("kind"), (_, i) => space.get_row(i))
  for (const row of rows) row.points = triples(row.points)
  const of = (...kinds) => rows.filter(row => kinds.includes(row.kind))
  if (of("axis").length == 0) return  // there is no picture yet

  const show = (name, rows, columns) => {
    if (!(name in seen)) return
    const found = rows(), data = {}
    for (const column of seen[name].columns()) data[column] = found.map(columns[column] ?? (row => row[column]))
    seen[name].setv({data}, {sync: false, check_eq: false})
  }
  const lines = {xs: row => row.flat.map(p => p[0]), ys: row => row.flat.map(p => p[1])}
  const points = {x: row => row.flat.at(-1)[0], y: row => row.flat.at(-1)[1]}
  const drawn = rows => rows.map(row => ({...row, flat: row.points.map(flat)}))
  const pieces = (rings, place) => rings.slice(1).map((ring, i) => ({flat: hull([...rings[i], ...ring].map(place))}))

  // which parts of a tendon lie beyond the axis as it is seen, and which of these the body hides
  const {points: axis} = of("axis")[0], radius = axis.map((_, i) => of("radius")[0].points[i][0])
  const parts = {under: [], hidden: [], over: []}
  for (const tendon of of("tendon")) {
    const place = tendon.points.map((point, i) => {
      const arm = minus(point, axis[i]), depth = dot(arm, sight)
      return depth >= 0 ? "over" : dot(arm, arm) - depth ** 2 < radius[i] ** 2 ? "hidden" : "under"
    })
    for (const part of Object.keys(parts)) {
      // a part begins where the one before it ends
      const there = i => place[i] == part || place[i - 1] == part
      const line = tendon.points.map((point, i) => there(i) ? flat(point) : [NaN, NaN])
      if (place.includes(part)) parts[part].push({...tendon, flat: line})
    }
  }

  const rings = of("ring").map(row => row.points), [floor] = of("floor")
  const plate = sight[0] < 0 ? "over" : "under", faces = dot(of("ahead")[0].points[0], sight) > 0
  show("shadow", () => pieces(rings, ([x, y]) => flat([x, y, floor.points[0][2]])), lines)
  show("floor", () => drawn(of("grid")), lines)
  show("under", () => [...drawn(of("rest", plate == "under" && "plate")), ...parts.under], lines)
  show("tube", () => pieces(rings, flat), lines)
  show("cap", () => drawn(faces ? of("ring").slice(-1) : []), lines)
  show("hidden", () => parts.hidden, lines)
  show("over", () => [...parts.over, ...drawn(of("past", "load", plate == "over" && "plate"))], lines)
  show("ends", () => drawn(of("end")), points)
  show("names", () => drawn(of("name")), points)
  for (const kind of ["data", "rows"]) {
    show(kind, () => of(kind).flatMap(row => row.points.map(point => ({flat: [flat(point)]}))), points)
  }
  show("heads", () => drawn(of("load")), {
    ...points,
    angle: ({flat: all}) => Math.atan2(all.at(-1)[1] - all.at(-2)[1], all.at(-1)[0] - all.at(-2)[0]) - Math.PI / 2,
  })
}
