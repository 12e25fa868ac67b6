// Joints in a step: their equations, impulses and corrections.
#include "rigid/solver.h"

namespace animtool::rigid {

namespace {

// Largest speed at which initial joint gaps close [m/s, rad/s].
constexpr double MAX_CLOSING_SPEED = 100;

}  // namespace

void Solver::begin_drives(const Joint& joint, std::size_t k) {
  for_each_drive(joint, k, [&](Drive& drive, Row& row) {
    begin_drive(joint, drive, row, speed_of(joint, row), h_);
  });
}

void Solver::end_drives(const Joint& joint, std::size_t k) {
  for_each_drive(joint, k, [&](Drive& drive, Row& row) {
    drive.first_impulse = row.impulse;
    end_drive(joint, drive, row, speed_of(joint, row), h_);
  });
}

template <typename Function>
void Solver::for_each_drive(const Joint& joint, std::size_t k, Function function) {
  if (!has_drive(joint)) return;
  for (std::size_t r = 0; r < rows_[k].count; ++r) {
    Row& row = rows_[k].entries[r];
    if (row.kind == Row::DRIVE)
      function(drives_[k][static_cast<std::size_t>(row.slot - SLOT_DRIVE)], row);
  }
}

void Solver::warm_start(const Joint& joint, Rows& rows, double scale) {
  for (std::size_t r = 0; r < rows.count; ++r) {
    Row& row = rows.entries[r];
    row.half_impulse = row.impulse = row.impulse * (scale / 2);
  }
  apply_half_impulses(joint, rows);
}

void Solver::warm_start_second_half(const Joint& joint, Rows& rows) {
  for (std::size_t r = 0; r < rows.count; ++r)
    rows.entries[r].impulse += rows.entries[r].half_impulse;
  apply_half_impulses(joint, rows);
}

void Solver::apply_half_impulses(const Joint& joint, const Rows& rows) {
  const std::size_t a = first_body(joint);
  for (std::size_t r = 0; r < rows.count; ++r) {
    const Row& row = rows.entries[r];
    if (row.half_impulse == 0) continue;
    apply(a, joint.b, row.line, speeds_[a].angular_response(row.arm_a),
          speeds_[joint.b].angular_response(row.arm_b), row.half_impulse);
  }
}

Solver::JointFrames Solver::joint_frames(std::size_t joint_index, double fraction,
                                         const State* state_a, const State& state_b) const {
  const Joint& joint = world_.joints[joint_index];
  JointFrames frames;
  if (joint.a < 0) {
    const Pose pose = anchors_[joint_index].pose_at(fraction);
    frames.a = {pose.to_world(joint.frame_a.position),
                unit(rotation_of_pose(pose) * joint.frame_a.rotation),
                {},
                {}};
    if (anchors_[joint_index].is_moving()) {
      frames.a.velocity = anchors_[joint_index].displacement(frames.a.position, pose) * (1 / step_);
      frames.a.angular_velocity = anchors_[joint_index].rotation() * (1 / step_);
    }
  } else {
    frames.a = anchor_on_body(*state_a, joint.frame_a);
    frames.arm_a = frames.a.position - state_a->position;
  }
  frames.b = anchor_on_body(state_b, joint.frame_b);
  frames.arm_b = frames.b.position - state_b.position;
  return frames;
}

void Solver::update_rows(std::size_t joint_index, std::size_t k, double fraction, bool is_first) {
  const Joint& joint = world_.joints[joint_index];
  std::array<double, JOINT_SLOT_COUNT> impulses{}, half_impulses{};
  if (is_first) {
    for (std::size_t i = 0; i < JOINT_SLOT_COUNT; ++i)
      impulses[i] = joint_impulses_[joint_index][i] * h_;
  } else {
    for (std::size_t r = 0; r < rows_[k].count; ++r) {
      const Row& row = rows_[k].entries[r];
      impulses[static_cast<std::size_t>(row.slot)] = row.impulse;
      half_impulses[static_cast<std::size_t>(row.slot)] = row.half_impulse;
    }
  }
  const JointFrames frames =
      joint_frames(joint_index, fraction, state_of_first(joint), states_[joint.b]);
  rows_[k] = build_rows(joint, frames.a, frames.b, frames.arm_a, frames.arm_b,
                        speeds_[first_body(joint)], speeds_[joint.b], h_);
  for (std::size_t r = 0; r < rows_[k].count; ++r) {
    Row& row = rows_[k].entries[r];
    const auto slot = static_cast<std::size_t>(row.slot);
    row.impulse = std::clamp(impulses[slot], row.min_impulse, row.max_impulse),
    row.half_impulse = half_impulses[slot];
  }
}

void Solver::set_curvature(std::size_t joint_index, Rows& rows, double end) {
  const Joint& joint = world_.joints[joint_index];
  const auto advance_state = [&](std::size_t i) {
    State s = states_[i];
    s.position = s.position + speeds_[i].v * h_;
    s.momentum = momentum_of(i);
    rotate_freely(i, s);
    return s;
  };
  const State state_b = advance_state(joint.b);
  const State state_a = joint.a < 0 ? State{} : advance_state(static_cast<std::size_t>(joint.a));
  const JointFrames frames = joint_frames(joint_index, end, &state_a, state_b);
  const Rows end_rows = build_rows(joint, frames.a, frames.b, frames.arm_a, frames.arm_b,
                                   speeds_[first_body(joint)], speeds_[joint.b], h_);
  for (std::size_t r = 0; r < rows.count; ++r) {
    Row& row = rows.entries[r];
    if (row.kind == Row::DRIVE) continue;
    for (std::size_t q = 0; q < end_rows.count; ++q) {
      if (end_rows.entries[q].slot != row.slot) continue;
      const double change = end_rows.entries[q].error - row.error;
      const bool is_rotation = dot(row.line, row.line) == 0;
      row.curvature_speed =
          (is_rotation ? std::remainder(change, FULL_CIRCLE) : change) / h_ - speed_of(joint, row);
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

Anchor Solver::anchor_on_body(const State& s, const Frame& frame) {
  return {s.position + rotate(s.rotation, frame.position), s.rotation * frame.rotation, {}, {}};
}

double Solver::correct_velocities(const Joint& joint, Rows& rows, bool correct_positions) {
  double max_change = 0;
  const std::size_t first_index = first_body(joint);
  Speed &a = speeds_[first_index], &b = speeds_[joint.b];
  for (std::size_t r = 0; r < rows.count; ++r) {
    Row& row = rows.entries[r];
    const double speed = speed_of(joint, row) + (correct_positions ? row.curvature_speed : 0);
    double change = 0;
    if (row.kind == Row::DRIVE) {
      change = -(row.speed_gain * speed + row.position_impulse + row.impulse) /
               (1 + row.speed_gain / row.mass);
    } else if (row.kind == Row::LIMIT && row.error > 0) {
      change = -row.mass * (speed + row.error / h_);
    } else if (correct_positions) {
      const double correction_speed =
          std::clamp(joint_softness_.bias_rate * row.error, -MAX_CLOSING_SPEED, MAX_CLOSING_SPEED);
      const bool is_rigid = are_joints_rigid_ && row.kind == Row::LOCK;
      change =
          -row.mass * (is_rigid ? 1 : joint_softness_.mass_factor) * (speed + correction_speed) -
          (is_rigid ? 0 : joint_softness_.impulse_factor) * row.impulse;
    } else {
      change = -row.mass * speed;
    }
    const double fraction = row.kind == Row::DRIVE && correct_positions ? 0.5 : 1;
    const double impulse =
        std::clamp(row.impulse + change, row.min_impulse * fraction, row.max_impulse * fraction);
    const double impulse_change = impulse - row.impulse;
    row.impulse = impulse;
    if (impulse_change == 0) continue;
    apply(first_index, joint.b, row.line, a.angular_response(row.arm_a),
          b.angular_response(row.arm_b), impulse_change);
    max_change = std::max(max_change, std::fabs(impulse_change) / row.mass);
  }
  return max_change;
}

}  // namespace animtool::rigid
