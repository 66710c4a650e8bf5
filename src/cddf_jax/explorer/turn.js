// Turns the body in space as it is dragged: half a degree for each pixel.
export default ({azimuth, elevation}, drag) => {
  if (drag.event_name == "panstart") azimuth.dragged = [azimuth.value, elevation.value]
  else if (azimuth.dragged) {
    const [around, up] = azimuth.dragged
    const turned = Math.round(around - 0.5 * drag.delta_x)
    azimuth.value = turned - 360 * Math.round(turned / 360)
    elevation.value = Math.max(-90, Math.min(90, Math.round(up + 0.5 * drag.delta_y)))
  }
}
