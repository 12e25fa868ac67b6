// Conversion between the coordinates of a rig and of a chain.
#include "ik/rig_map.h"

#include <algorithm>
#include <cmath>

#include "base/checks.h"
#include "ik/limits.h"

namespace animtool::ik {

RigMap::RigMap(const RigMapArrays& arrays, const Chain& chain, std::size_t width) {
  const std::size_t count = chain.coordinate_count, ball_count = arrays.balls.shape(0);
  const std::size_t mimic_count = arrays.mimics.shape(0);
  check::shape("columns", arrays.columns, {count});
  check::shape("scales", arrays.scales, {count});
  check::shape("periods", arrays.periods, {count, 2});
  check::shape("balls", arrays.balls, {ball_count});
  check::shape("ball_frames", arrays.ball_frames, {ball_count, 4});
  check::shape("mimics", arrays.mimics, {mimic_count, 2});
  check::shape("mimic_numbers", arrays.mimic_numbers, {mimic_count, 2});
  check::indices("columns", arrays.columns.data(), count, 0, static_cast<std::int64_t>(width));
  check::indices("mimics", arrays.mimics.data(), 2 * mimic_count, 0,
                 static_cast<std::int64_t>(width));
  for (std::size_t c = 0; c < count; ++c) {
    const double* period = arrays.periods.data() + 2 * c;
    if (!(arrays.scales.data()[c] > 0)) check::refuse("scales", "a scale is not more than 0");
    coordinates_.push_back({static_cast<std::size_t>(arrays.columns.data()[c]),
                            arrays.scales.data()[c], period[0], period[1]});
  }
  for (std::size_t i = 0; i < ball_count; ++i) {
    const std::int64_t first = arrays.balls.data()[i];
    check::between("balls", first, 0, static_cast<std::int64_t>(count) - 4);
    Ball ball{static_cast<std::size_t>(first), {}, {}};
    std::copy(arrays.ball_frames.data() + 4 * i, arrays.ball_frames.data() + 4 * i + 4, ball.frame);
    for (int k = 0; k < 4; ++k) ball.inverse_frame[k] = k < 3 ? -ball.frame[k] : ball.frame[k];
    balls_.push_back(ball);
  }
  for (std::size_t i = 0; i < mimic_count; ++i) {
    const std::int64_t* columns = arrays.mimics.data() + 2 * i;
    const double* numbers = arrays.mimic_numbers.data() + 2 * i;
    mimics_.push_back({static_cast<std::size_t>(columns[0]), static_cast<std::size_t>(columns[1]),
                       numbers[0], numbers[1]});
  }
}

void RigMap::to_chain(const double* rig, double* q) const {
  for (std::size_t c = 0; c < coordinates_.size(); ++c)
    q[c] = rig[coordinates_[c].column] / coordinates_[c].scale;
  for (const Ball& ball : balls_) {
    double* values = q + ball.first_coordinate;
    double rotated_values[3];
    make_unit(values);
    rotate_vector(ball.frame, values, rotated_values);
    std::copy(rotated_values, rotated_values + 3, values);
  }
}

void RigMap::to_rig(const double* q, double* rig) const {
  for (std::size_t c = 0; c < coordinates_.size(); ++c) {
    const auto& [column, scale, low, high] = coordinates_[c];
    double value = q[c];
    if (std::isfinite(low) && (value < low || value > high)) {
      const double revolutions = std::nearbyint((value - (low + high) / 2) / REVOLUTION);
      value = std::clamp(value - REVOLUTION * revolutions, low, high);
    }
    rig[column] = value * scale;
  }
  for (const Ball& ball : balls_) {
    const double* values = q + ball.first_coordinate;
    double rotated_values[3];
    rotate_vector(ball.inverse_frame, values, rotated_values);
    for (int i = 0; i < 3; ++i)
      rig[coordinates_[ball.first_coordinate + i].column] =
          rotated_values[i] * coordinates_[ball.first_coordinate + i].scale;
  }
  for (const Mimic& mimic : mimics_)
    rig[mimic.column] = mimic.gain * rig[mimic.leader] + mimic.offset;
}

}  // namespace animtool::ik
