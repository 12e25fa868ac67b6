// The state of a rigid body step: see `solve.cpp`.
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

// Stiffness of contact and joint correction: frequency over that of substeps, and damping ratio.
constexpr double STIFF = 0.35;
constexpr double CONTACT_DAMPING = 10, JOINT_DAMPING = 2;

class Solver {
 public:
  Solver(const World& world, std::vector<State>& states, std::vector<StoredContact>& stored,
         std::vector<std::array<double, ROWS>>& joint_impulses, const std::vector<Vec>& forces,
         const std::vector<Vec>& torques, const std::vector<collide::Collider>& colliders,
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
        count_(states.size()) {}

  // Whether two approach so fast that they will bounce within the step.
  bool bounces();
  Report run();

 private:
  struct Island {
    std::vector<std::size_t> bodies, joints;
    std::vector<std::size_t> contacts;
    bool separating = false;  // some penetration is still being resolved
  };
  void find();

  // ---- sleeping

  void begin_groups();
  bool sleeps(std::size_t i) const { return asleep(states_[i], settings_); }

  // Wakes bodies in contact with awake ones, transitively.
  bool wake();
  void make_islands();

  // ---- one island

  void solve(Island& island);

  // Chooses substeps of an island, shorter if a drive swings in them.
  void choose_substeps(const Island& island);
  void resize(int parts);
  void soften();

  // Counts the points at which friction supports bodies: sliding and rolling ones do not count.
  void count_supports(const Patch& patch);
  void refresh(std::size_t i);
  void add_patch(const Contact& c);

  // One point for both, so that angular momentum is conserved: halfway, or on the round body.
  static Vec touching_point(const Patch& patch, Vec at_a, Vec at_b) {
    const Contact& c = *patch.contact;
    if (c.radius > 0) return at_a + patch.normal * c.radius;
    if (c.other_radius > 0) return at_b - patch.normal * c.other_radius;
    return (at_a + at_b) * 0.5;
  }

  // A contact point at the current poses.
  void set_arms(const Patch& patch, Point& p, Vec at);

  // Warm start with the impulses of the previous step.
  void match_stored(Patch& patch);
  void save(const Patch& patch);

  // ---- one substep

  // Advances from impact to impact, and through the rest of a substep.
  void substep(const Island& island, int s);

  // As RATTLE does (Andersen 1983): half a kick, a drift that satisfies joints and contacts at its
  // end, half a kick, and a velocity correction there.
  void advance(const Island& island, double time, double end);
  void begin_drives(const Joint& joint, std::size_t k);
  void end_drives(const Joint& joint, std::size_t k);
  template <typename Act>
  void each_drive(const Joint& joint, std::size_t k, Act act);

  // ---- impacts

  // Time until the first bouncing arrival, at most the rest; present ones bounce before.
  double until_impact(const Island& island, double remaining, double begin, double end);

  // Marks points approaching so fast that they bounce; returns the first arrival, or the rest.
  double next_arrival(double remaining, double fraction);

  // Time at which a point closes its gap with both bodies in motion, within a limit: by the
  // Illinois method.
  double arrival(const Patch& patch, const Point& p, double fraction, double within) const;
  double gap_at(const Patch& patch, const Point& p, double fraction, double time) const;

  // Speed below which two rest instead of bouncing: forces reverse slower motion within a substep.
  double rest_speed(std::size_t a, std::size_t b, double restitution) const;
  double rest_speed(const Patch& patch) const {
    return rest_speed(patch.a, patch.b, patch.restitution);
  }

  // Updates current contact points.
  void update_points(double fraction);

  // Relative acceleration of the second body.
  Vec relative_acceleration(const Patch& patch) const;
  static double normal_acceleration(const Patch& patch, Vec pull) {
    return -dot(pull, patch.normal);
  }

  double approach(const Patch& patch, const Point& p) const {
    return speed_along(speeds_, patch, p, 0);
  }

  // Applies forces for half a substep.
  void apply_forces(std::size_t i);

  void apply(std::size_t a, std::size_t b, Vec line, Vec response_a, Vec response_b,
             double impulse) {
    rigid::apply(speeds_, a, b, line, response_a, response_b, impulse);
  }

  // Applies the impulses of the previous substep for half the time.
  void warm_start(Patch& patch, double scale);
  void warm_finish(Patch& patch);
  void apply_half(const Patch& patch, const Point& p);
  void warm_start(const Joint& joint, Rows& rows, double scale);
  void warm_finish(const Joint& joint, Rows& rows);

  std::size_t first_of(const Joint& joint) const {
    return joint.a < 0 ? count_ : static_cast<std::size_t>(joint.a);
  }

  void apply_half(const Joint& joint, const Rows& rows);

  // Frames of a joint at a fraction of the step, and their arms.
  struct Frames {
    Anchor a, b;
    Vec arm_a, arm_b;
  };
  Frames frames_of(std::size_t number, double fraction, const State* on_a, const State& on_b) const;

  const State* first_state(const Joint& joint) const {
    return joint.a < 0 ? nullptr : &states_[static_cast<std::size_t>(joint.a)];
  }

  void write_rows(std::size_t number, std::size_t k, double fraction, bool first);

  // Change of a joint's errors to the end of the substep beyond its linear equations, over the
  // time.
  void set_curvature(std::size_t number, Rows& rows, double end);

  double speed_of(const Joint& joint, const Row& row) const {
    const Speed &a = speeds_[first_of(joint)], &b = speeds_[joint.b];
    return dot(row.line, b.v - a.v) + dot(row.arm_b, b.w) - dot(row.arm_a, a.w) + row.bias_speed;
  }

  static Quaternion rotation_of_pose(const Pose& pose);
  static Anchor anchor_of(const State& s, const Frame& frame);

  // Iterates velocity corrections until convergence, with or without position correction.
  void iterate(const Island& island, bool pushing);
  double correct(Patch& patch, bool pushing);
  double correct(const Joint& joint, Rows& rows, bool pushing);

  // Moves bodies for a substep.
  void move(std::size_t i);
  void rotate_freely(std::size_t i, State& s) const;
  Vec momentum_of(std::size_t i) const;

  // Marks bodies pushed by contacts and joints.
  void mark(const Island& island);

  // Velocities in the layout of states.
  void store_velocity(std::size_t i);

  // ---- stored state

  void store_contacts();

  // Puts islands to sleep that are slow for long enough and supported by friction. Unsupported
  // ones, or those held by joints only, continue until they hardly move.
  void update_sleep();

  // Whether an island is supported; otherwise it is at rest only without forces.
  bool supported(const Island& island) const;

  const World& world_;
  std::vector<State>& states_;
  std::vector<StoredContact>& stored_contacts_;
  std::vector<std::array<double, ROWS>>& joint_impulses_;
  const std::vector<Vec>&forces_, &torques_;
  const std::vector<collide::Collider>& colliders_;
  const std::vector<collide::Motion>& anchors_;
  const Settings& settings_;
  double step_, substep_, h_;  // step, substep, and time between impacts [s]
  std::size_t count_;
  Softness contact_ = Softness::of(STIFF / substep_, CONTACT_DAMPING, h_);
  Softness joint_ = Softness::of(STIFF / substep_, JOINT_DAMPING, h_);
  std::vector<Contact> contacts_;
  bool has_contacts_ = false;  // whether contacts of this step are found
  Groups groups_;
  std::vector<Island> islands_;
  std::vector<Speed> speeds_;  // of bodies, and of static ones
  std::vector<Pose> poses_;
  std::vector<char> pushed_;
  std::vector<int> support_counts_;  // number of supporting points
  int parts_ = 1;                    // substeps
  std::vector<Drives> drives_;
  bool hard_ = false;    // whether joints are rigid, so that drives move the right mass
  bool bouncy_ = false;  // whether something may bounce
  std::vector<Patch> patches_;
  std::vector<Point> points_;
  std::vector<Rows> rows_;
  std::vector<StoredContact> next_contacts_;
  Report report_;
};

}  // namespace animtool::rigid
