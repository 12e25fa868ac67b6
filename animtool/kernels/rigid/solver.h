// The solver of a rigid body step: see `solve.cpp`.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "base/groups.h"
#include "rigid/drives.h"
#include "rigid/impacts.h"
#include "rigid/points.h"
#include "rigid/world.h"

namespace animtool::rigid {

// Stiffness of contact and joint correction: frequency over that of substeps; and damping ratios.
constexpr double STIFFNESS_RATIO = 0.35;
constexpr double CONTACT_DAMPING = 10, JOINT_DAMPING = 2;

// Solves one step of a world.
class Solver {
 public:
  Solver(const World& world, std::vector<State>& states, std::vector<StoredContact>& stored,
         std::vector<std::array<double, JOINT_SLOT_COUNT>>& joint_impulses,
         const std::vector<Vec>& forces, const std::vector<Vec>& torques,
         const std::vector<collide::Collider>& colliders,
         const std::vector<collide::Motion>& anchors, const Settings& settings, double step)
      : world_(world),
        states_(states),
        stored_contacts_(stored),
        joint_impulses_(joint_impulses),
        forces_(forces),
        torques_(torques),
        colliders_(colliders),
        anchors_(anchors),
        settings_(settings),
        step_(step),
        substep_(step / settings.substeps),
        h_(substep_),
        body_count_(states.size()) {}

  // Whether two bodies approach so fast that they will bounce within the step.
  bool has_bounces();
  Report run();

 private:
  // Bodies that are connected by contacts and joints.
  struct Island {
    std::vector<std::size_t> bodies, joints;
    std::vector<std::size_t> contacts;
    bool has_penetration = false;  // some penetration is still being resolved
  };
  // Finds the contacts of the step.
  void update_contacts();

  // ---- sleeping

  // Groups bodies that joints connect.
  void reset_groups();
  bool is_asleep(std::size_t i) const { return is_state_asleep(states_[i], settings_); }

  // Wakes bodies that are in contact with awake ones, transitively; returns whether any woke up.
  bool wake_bodies();
  void build_islands();

  // ---- one island

  void solve_island(Island& island);

  // Chooses the substeps of an island; they are shorter if a drive oscillates in them.
  void choose_substeps(const Island& island);
  void set_substeps(int count);
  void update_softness();

  // Counts the points at which friction supports bodies; sliding and rolling points do not count.
  void count_supports(const Patch& patch);
  // Rotates the inverse inertia of a body to the world.
  void update_inertia(std::size_t i);
  void add_patch(const Contact& c);

  // One position for both bodies, so that angular momentum is conserved: halfway, or on the round
  // body.
  static Vec contact_position(const Patch& patch, Vec point_a, Vec point_b) {
    const Contact& c = *patch.contact;
    if (c.radius > 0) return point_a + patch.normal * c.radius;
    if (c.other_radius > 0) return point_b - patch.normal * c.other_radius;
    return (point_a + point_b) * 0.5;
  }

  // Updates the arms and masses of a contact point at the current poses.
  void set_arms(const Patch& patch, Point& p, Vec position);

  // Warm-starts points with the impulses of matching points of the previous step.
  void match_stored_contacts(Patch& patch);
  // Stores the contact points for the next step, and reports them.
  void store_patch(const Patch& patch);

  // ---- one substep

  // Advances from impact to impact, and through the remaining substep.
  void advance_substep(const Island& island, int index);

  // Advances as RATTLE does (Andersen 1983): half a kick, a drift that satisfies joints and
  // contacts at its end, half a kick, and a velocity correction at the end.
  void advance(const Island& island, double duration, double end_fraction);
  void begin_drives(const Joint& joint, std::size_t k);
  void end_drives(const Joint& joint, std::size_t k);
  template <typename Function>
  void for_each_drive(const Joint& joint, std::size_t k, Function function);

  // ---- impacts

  // Time until the first bouncing arrival, at most the remaining time; points in contact bounce
  // first.
  double time_to_impact(const Island& island, double remaining, double begin_fraction,
                        double end_fraction);

  // Marks points that approach so fast that they bounce; returns the first arrival, or the
  // remaining time.
  double mark_bounces(double remaining, double fraction);

  // Time at which a point closes its gap, with both bodies in motion, up to a limit; by the
  // Illinois method.
  double time_of_arrival(const Patch& patch, const Point& p, double fraction, double limit) const;
  // Gap of a point after a time.
  double gap_at(const Patch& patch, const Point& p, double fraction, double time) const;

  // Speed below which two bodies rest instead of bouncing: forces reverse slower motion within a
  // substep.
  double rest_speed(std::size_t a, std::size_t b, double restitution) const;
  double rest_speed(const Patch& patch) const {
    return rest_speed(patch.a, patch.b, patch.restitution);
  }

  // Updates the current gaps and arms of contact points.
  void update_points(double fraction);

  // Acceleration of the second body relative to the first.
  Vec relative_acceleration(const Patch& patch) const;
  static double normal_acceleration(const Patch& patch, Vec acceleration) {
    return -dot(acceleration, patch.normal);
  }

  double separation_speed(const Patch& patch, const Point& p) const {
    return speed_along(speeds_, patch, p, 0);
  }

  // Applies forces for half a substep.
  void apply_forces(std::size_t i);

  void apply(std::size_t a, std::size_t b, Vec line, Vec response_a, Vec response_b,
             double impulse) {
    rigid::apply(speeds_, a, b, line, response_a, response_b, impulse);
  }

  // Applies the impulses of the previous substep for half of the time.
  void warm_start(Patch& patch, double scale);
  void warm_start_second_half(Patch& patch);
  void apply_half_impulses(const Patch& patch, const Point& p);
  void warm_start(const Joint& joint, Rows& rows, double scale);
  void warm_start_second_half(const Joint& joint, Rows& rows);

  // The first body of a joint; the static one for an animated frame.
  std::size_t first_body(const Joint& joint) const {
    return joint.a < 0 ? body_count_ : static_cast<std::size_t>(joint.a);
  }

  void apply_half_impulses(const Joint& joint, const Rows& rows);

  // Frames of a joint in the world at a fraction of the step, and their arms from the centres.
  struct JointFrames {
    Anchor a, b;
    Vec arm_a, arm_b;
  };
  JointFrames joint_frames(std::size_t joint_index, double fraction, const State* state_a,
                           const State& state_b) const;

  const State* state_of_first(const Joint& joint) const {
    return joint.a < 0 ? nullptr : &states_[static_cast<std::size_t>(joint.a)];
  }

  // Rebuilds the rows of a joint; impulses stay, or are those of the previous step if `is_first`.
  void update_rows(std::size_t joint_index, std::size_t k, double fraction, bool is_first);

  // Sets the change of a joint's errors to the end of the substep beyond its linear equations, as a
  // speed.
  void set_curvature(std::size_t joint_index, Rows& rows, double end);

  // Relative speed of a row.
  double speed_of(const Joint& joint, const Row& row) const {
    const Speed &a = speeds_[first_body(joint)], &b = speeds_[joint.b];
    return dot(row.line, b.v - a.v) + dot(row.arm_b, b.w) - dot(row.arm_a, a.w) + row.bias_speed;
  }

  static Quaternion rotation_of_pose(const Pose& pose);
  static Anchor anchor_on_body(const State& s, const Frame& frame);

  // Iterates velocity corrections until convergence, with or without position correction.
  void iterate(const Island& island, bool correct_positions);
  double correct_velocities(Patch& patch, bool correct_positions);
  double correct_velocities(const Joint& joint, Rows& rows, bool correct_positions);

  // Moves a body for a substep.
  void move_body(std::size_t i);
  void rotate_freely(std::size_t i, State& s) const;
  Vec momentum_of(std::size_t i) const;

  // Marks the bodies that contacts and joints push.
  void mark_pushed(const Island& island);

  // Stores the velocity of a pushed body in its state.
  void store_velocity(std::size_t i);

  // ---- stored state

  void store_contacts();

  // Puts islands to sleep that are slow for long enough and supported by friction. Unsupported
  // islands, or those held by joints only, continue until they hardly move.
  void update_sleep();

  // Whether an island is supported; an unsupported one is at rest only without forces.
  bool is_supported(const Island& island) const;

  const World& world_;
  std::vector<State>& states_;
  std::vector<StoredContact>& stored_contacts_;
  std::vector<std::array<double, JOINT_SLOT_COUNT>>& joint_impulses_;
  const std::vector<Vec>&forces_, &torques_;
  const std::vector<collide::Collider>& colliders_;
  const std::vector<collide::Motion>& anchors_;
  const Settings& settings_;
  double step_, substep_, h_;  // length of the step and of a substep, and time between impacts [s]
  std::size_t body_count_;
  Softness contact_softness_ =
      Softness::from_frequency(STIFFNESS_RATIO / substep_, CONTACT_DAMPING, h_);
  Softness joint_softness_ =
      Softness::from_frequency(STIFFNESS_RATIO / substep_, JOINT_DAMPING, h_);
  std::vector<Contact> contacts_;
  bool are_contacts_known_ = false;  // whether the contacts of this step are known
  Groups groups_;
  std::vector<Island> islands_;
  std::vector<Speed> speeds_;  // of bodies, and of static ones
  std::vector<Pose> poses_;
  std::vector<char> is_pushed_;
  std::vector<int> support_counts_;  // number of supporting points of each body
  int substep_count_ = 1;            // substeps
  std::vector<Drives> drives_;
  bool are_joints_rigid_ =
      false;  // whether joints are solved as rigid, so that drives move the right mass
  bool has_restitution_ = false;  // whether any contact may bounce
  std::vector<Patch> patches_;
  std::vector<Point> points_;
  std::vector<Rows> rows_;
  std::vector<StoredContact> next_contacts_;
  Report report_;
};

}  // namespace animtool::rigid
