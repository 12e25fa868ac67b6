// Joints in a step: their equations, impulses and corrections.
#include "rigid/solver.h"

namespace animtool::rigid {

namespace {

// Largest speed at which initial joint gaps close [m/s, rad/s].
constexpr double MAX_CLOSING_SPEED = 100;

}  // namespace

void Solver::begin_drives(const Joint& joint, std::size_t k) {
  each_drive(joint, k, [&](Drive& drive, Row& row) {
    begin_drive(joint, drive, row, speed_of(joint, row), h_);
  });
}

void Solver::end_drives(const Joint& joint, std::size_t k) {
  each_drive(joint, k, [&](Drive& drive, Row& row) {
    drive.first_impulse = row.impulse;
    end_drive(joint, drive, row, speed_of(joint, row), h_);
  });
}

template <typename Act>
void Solver::each_drive(const Joint& joint, std::size_t k, Act act) {
  if (!driven(joint)) return;
  for (std::size_t r = 0; r < rows_[k].count; ++r) {
    Row& row = rows_[k].of[r];
    if (row.kind == Row::DRIVE)
      act(drives_[k][static_cast<std::size_t>(row.slot - SLOT_DRIVE)], row);
  }
}

void Solver::warm_start(const Joint& joint, Rows& rows, double scale) {
  for (std::size_t r = 0; r < rows.count; ++r) {
    Row& row = rows.of[r];
    row.half = row.impulse = row.impulse * (scale / 2);
  }
  apply_half(joint, rows);
}

void Solver::warm_finish(const Joint& joint, Rows& rows) {
  for (std::size_t r = 0; r < rows.count; ++r) rows.of[r].impulse += rows.of[r].half;
  apply_half(joint, rows);
}

void Solver::apply_half(const Joint& joint, const Rows& rows) {
  const std::size_t a = first_of(joint);
  for (std::size_t r = 0; r < rows.count; ++r) {
    const Row& row = rows.of[r];
    if (row.half == 0) continue;
    apply(a, joint.b, row.line, speeds_[a].angular_response(row.arm_a),
          speeds_[joint.b].angular_response(row.arm_b), row.half);
  }
}

Solver::Frames Solver::frames_of(std::size_t number, double fraction, const State* on_a,
                                 const State& on_b) const {
  const Joint& joint = world_.joints[number];
  Frames frames;
  if (joint.a < 0) {
    const Pose pose = anchors_[number].at(fraction);
    frames.a = {
        pose.to_world(joint.on_a.at), unit(rotation_of_pose(pose) * joint.on_a.rotation), {}, {}};
    if (anchors_[number].moves()) {
      frames.a.velocity = anchors_[number].displacement(frames.a.at, pose) * (1 / step_);
      frames.a.spin = anchors_[number].rotation() * (1 / step_);
    }
  } else {
    frames.a = anchor_of(*on_a, joint.on_a);
    frames.arm_a = frames.a.at - on_a->at;
  }
  frames.b = anchor_of(on_b, joint.on_b);
  frames.arm_b = frames.b.at - on_b.at;
  return frames;
}

void Solver::write_rows(std::size_t number, std::size_t k, double fraction, bool first) {
  const Joint& joint = world_.joints[number];
  std::array<double, ROWS> before{}, half{};
  if (first) {
    for (std::size_t i = 0; i < ROWS; ++i) before[i] = joint_impulses_[number][i] * h_;
  } else {
    for (std::size_t r = 0; r < rows_[k].count; ++r) {
      const Row& row = rows_[k].of[r];
      before[static_cast<std::size_t>(row.slot)] = row.impulse;
      half[static_cast<std::size_t>(row.slot)] = row.half;
    }
  }
  const Frames f = frames_of(number, fraction, first_state(joint), states_[joint.b]);
  rows_[k] =
      rows_of(joint, f.a, f.b, f.arm_a, f.arm_b, speeds_[first_of(joint)], speeds_[joint.b], h_);
  for (std::size_t r = 0; r < rows_[k].count; ++r) {
    Row& row = rows_[k].of[r];
    const auto slot = static_cast<std::size_t>(row.slot);
    row.impulse = std::clamp(before[slot], row.low, row.high), row.half = half[slot];
  }
}

void Solver::set_curvature(std::size_t number, Rows& rows, double end) {
  const Joint& joint = world_.joints[number];
  const auto advanced = [&](std::size_t i) {
    State s = states_[i];
    s.at = s.at + speeds_[i].v * h_;
    s.momentum = momentum_of(i);
    rotate_freely(i, s);
    return s;
  };
  const State on_b = advanced(joint.b);
  const State on_a = joint.a < 0 ? State{} : advanced(static_cast<std::size_t>(joint.a));
  const Frames f = frames_of(number, end, &on_a, on_b);
  const Rows after =
      rows_of(joint, f.a, f.b, f.arm_a, f.arm_b, speeds_[first_of(joint)], speeds_[joint.b], h_);
  for (std::size_t r = 0; r < rows.count; ++r) {
    Row& row = rows.of[r];
    if (row.kind == Row::DRIVE) continue;
    for (std::size_t q = 0; q < after.count; ++q) {
      if (after.of[q].slot != row.slot) continue;
      const double change = after.of[q].error - row.error;
      const bool rotates = dot(row.line, row.line) == 0;
      row.curvature_speed =
          (rotates ? std::remainder(change, FULL_CIRCLE) : change) / h_ - speed_of(joint, row);
    }
  }
}

Quaternion Solver::rotation_of_pose(const Pose& pose) {
  const double* m = pose.rotation;
  const double w = std::sqrt(std::max(0.0, 1 + m[0] + m[4] + m[8])) / 2;
  const double x = std::sqrt(std::max(0.0, 1 + m[0] - m[4] - m[8])) / 2;
  const double y = std::sqrt(std::max(0.0, 1 - m[0] + m[4] - m[8])) / 2;
  const double z = std::sqrt(std::max(0.0, 1 - m[0] - m[4] + m[8])) / 2;
  return {std::copysign(x, m[7] - m[5]), std::copysign(y, m[2] - m[6]),
          std::copysign(z, m[3] - m[1]), w};
}

Anchor Solver::anchor_of(const State& s, const Frame& frame) {
  return {s.at + rotate(s.rotation, frame.at), s.rotation * frame.rotation, {}, {}};
}

double Solver::correct(const Joint& joint, Rows& rows, bool pushing) {
  double most = 0;
  const std::size_t first = first_of(joint);
  Speed &a = speeds_[first], &b = speeds_[joint.b];
  for (std::size_t r = 0; r < rows.count; ++r) {
    Row& row = rows.of[r];
    const double speed = speed_of(joint, row) + (pushing ? row.curvature_speed : 0);
    double change = 0;
    if (row.kind == Row::DRIVE) {
      change = -(row.give * speed + row.push + row.impulse) / (1 + row.give / row.mass);
    } else if (row.kind == Row::LIMIT && row.error > 0) {
      change = -row.mass * (speed + row.error / h_);
    } else if (pushing) {
      const double correction_speed =
          std::clamp(joint_.bias * row.error, -MAX_CLOSING_SPEED, MAX_CLOSING_SPEED);
      const bool hard = hard_ && row.kind == Row::LOCK;
      change = -row.mass * (hard ? 1 : joint_.mass) * (speed + correction_speed) -
               (hard ? 0 : joint_.leak) * row.impulse;
    } else {
      change = -row.mass * speed;
    }
    const double half = row.kind == Row::DRIVE && pushing ? 0.5 : 1;
    const double to = std::clamp(row.impulse + change, row.low * half, row.high * half);
    const double by = to - row.impulse;
    row.impulse = to;
    if (by == 0) continue;
    apply(first, joint.b, row.line, a.angular_response(row.arm_a), b.angular_response(row.arm_b),
          by);
    most = std::max(most, std::fabs(by) / row.mass);
  }
  return most;
}

}  // namespace animtool::rigid
