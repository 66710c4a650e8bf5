// Turns the body in space as it is dragged: half a degree for each pixel.
let start = [0, 0]

export default ({azimuth, elevation}, drag) => {
  if (drag.event_name == "panstart") start = [azimuth.value, elevation.value]
  else {
    const around = Math.round(start[0] - 0.5 * drag.delta_x)
    azimuth.value = around - 360 * Math.round(around / 360)
    elevation.value = Math.max(-90, Math.min(90, Math.round(start[1] + 0.5 * drag.delta_y)))
  }
}
