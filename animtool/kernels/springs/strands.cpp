// Strands over a frame, four at a time from its start to its end, so that their data stays in the
// cache.
#include "springs/strands.h"

#include <algorithm>
#include <cmath>
#include <system_error>
#include <thread>

#include "base/checks.h"
#include "springs/loops.h"
#include "springs/steps.h"

namespace animtool {

namespace {

using collide::load;
using collide::store;
using collide::Vec;

std::size_t bundles_of(std::size_t strands) { return (strands + WIDE - 1) / WIDE; }

// Padding strands repeat the last one.
std::size_t strand_of(std::size_t bundle, std::size_t lane, std::size_t strands) {
  return std::min(bundle * WIDE + lane, strands - 1);
}

// Rows of strands (S, count), interleaved by bundle and padded to `width`.
std::vector<double> interleaved(In<double, 2> rows, std::size_t strands, std::size_t width) {
  std::vector<double> built(bundles_of(strands) * WIDE * width);
  for (std::size_t b = 0; b < bundles_of(strands); ++b)
    for (std::size_t l = 0; l < WIDE; ++l)
      for (std::size_t k = 0; k < rows.shape(1); ++k)
        built[(b * width + k) * WIDE + l] =
            rows.data()[strand_of(b, l, strands) * rows.shape(1) + k];
  return built;
}

// Colliders of all steps of a frame, in the layout of bundle loops.
class FrameColliders {
 public:
  // The common drift is that of the first particle, whose path is known.
  FrameColliders(const MovingColliders& colliders, const std::optional<SpringColliders>& arrays,
                 std::size_t cells, int substeps, double h, const double* targets,
                 std::size_t particles)
      : colliders_(colliders), h_(h), count_(colliders.size()) {
    const auto surfaces = arrays ? std::get<5>(*arrays).size() : 0;
    count_ += surfaces;
    moving_.reserve(surfaces * cells);
    std::vector<StepCollider> rigid;
    for (std::size_t cell = 0; cell < cells; ++cell) {
      const double* now = targets + 3 * particles * cell;
      double drift[3];
      for (std::size_t k = 0; k < 3; ++k) drift[k] = (now[3 * particles + k] - now[k]) / substeps;
      rigid.clear();
      colliders.steps(static_cast<std::int64_t>(cell), substeps, h, rigid);
      for (std::size_t s = 0; s < surfaces; ++s) {
        moving_.emplace_back(std::get<5>(*arrays)[s], static_cast<std::int64_t>(cells));
        moving_.back().begin_cell(static_cast<std::int64_t>(cell), h * substeps);
      }
      for (int j = 0; j < substeps; ++j) {
        const auto first = rigid.begin() + j * static_cast<std::ptrdiff_t>(colliders.size());
        rows_.insert(rows_.end(), first, first + static_cast<std::ptrdiff_t>(colliders.size()));
        for (std::size_t s = 0; s < surfaces; ++s)
          rows_.push_back(step_of(moving_[moving_.size() - surfaces + s],
                                  static_cast<std::int32_t>(s), j, substeps, load(drift)));
        drifts_.insert(drifts_.end(), drift, drift + 3);
      }
    }
    for (const StepCollider& one : rows_) rods_.push_back(one.rod);
    for (std::size_t c = 0; c < count_; ++c) {
      thicknesses_.push_back(rows_[c].thickness(colliders.radius()));
      is_rod_.push_back(rows_[c].is_rod);
      is_bounded_.push_back(rows_[c].is_rod || rows_[c].surface >= 0);
    }
    fill_lookahead();
  }

  const StepCollider& row(std::size_t step, std::size_t c) const {
    return rows_[step * count_ + c];
  }

  void fill(StrandSteps& plan) const {
    plan.colliders = count_;
    plan.rods = rods_.data();
    plan.is_rod = is_rod_.data();
    plan.is_bounded = is_bounded_.data();
    plan.depth_rows = colliders_.depth_rows();
    plan.thicknesses = thicknesses_.data();
    plan.drifts = drifts_.data();
    plan.remaining = lookahead_.data();
    plan.others = {this, &FrameColliders::sample, &FrameColliders::sweep};
    plan.tolerance = colliders_.tolerance();
  }

 private:
  // A step of a moving mesh, whose friction is that of a surface that drifts along.
  StepCollider step_of(const MovingSurface& mesh, std::int32_t index, int step, int substeps,
                       Vec drift) const {
    StepCollider built{};
    built.surface = index;
    built.elapsed = mesh.knot_fraction(double(step) / substeps);
    const double ended = mesh.knot_fraction(double(step + 1) / substeps);
    built.duration = ended - built.elapsed;
    built.collider = mesh.collider(ended);
    built.shift = mesh.relative_travel(drift, built.duration);
    built.rod.friction = built.collider.friction;
    built.rod.max_rise = built.collider.depenetration * h_;
    store(drift, built.rod.travel);
    return built;
  }

  void fill_lookahead() {
    const std::size_t count = count_;
    lookahead_.assign(rows_.size() + count, 0.0);
    for (std::size_t row = rows_.size(); row-- > 0;) {
      const Vec drift = load(&drifts_[3 * (row / count)]);
      lookahead_[row] = lookahead_[row + count];
      if (rows_[row].is_rod) lookahead_[row] += rows_[row].travel(drift);
      if (rows_[row].surface >= 0) lookahead_[row] += rows_[row].shift;
    }
  }

  static void sample(const void* all, std::size_t row, bool end, const double* point,
                     double* answer) {
    const auto& self = *static_cast<const FrameColliders*>(all);
    const StepCollider& one = self.rows_[row];
    const double radius = self.colliders_.radius();
    const auto hit = end ? one.after(load(point), radius) : one.before(load(point), radius);
    answer[0] = hit.distance;
    store(hit.normal, answer + 1);
  }

  static bool sweep(const void* all, std::size_t row, const double* from, double* to) {
    const auto& self = *static_cast<const FrameColliders*>(all);
    Vec location = load(to);
    const double radius = self.colliders_.radius();
    if (!self.rows_[row].sweep(self.h_, radius, load(from), location, nullptr)) return false;
    store(location, to);
    return true;
  }

  const MovingColliders& colliders_;
  double h_;
  std::size_t count_;                  // colliders and moving meshes
  std::vector<MovingSurface> moving_;  // (cells, S)
  std::vector<StepCollider> rows_;     // (steps, C)
  std::vector<collide::Rod> rods_;
  std::vector<double> drifts_, lookahead_, thicknesses_;
  std::vector<unsigned char> is_rod_, is_bounded_;
};

// Buffers for one bundle at a time, and the frame's arrays.
class Bundles {
 public:
  Bundles(const SpringStrands& strands, const StrandSteps& plan, const MovingColliders& colliders,
          const FrameColliders& frame, const CarrierColliders& own, const double* targets,
          const double* state, double* out)
      : strands_(strands),
        plan_(plan),
        colliders_(colliders),
        frame_(frame),
        targets_(targets),
        state_(state),
        out_(out),
        rows_(6 * width()),
        goals_((plan.cells + 1) * width()),
        contact_shifts_(plan.points * (plan.colliders + 2)),
        near_(plan.colliders),
        contact_counts_(plan.cells * plan.substeps),
        at_segments_(plan.points),
        row_before_(ROW * plan.points),
        row_(ROW * plan.points) {
    for (const SpringElements& one : strands.segments()) {
      FaceContacts& segments = segments_.emplace_back(one, colliders.radius());
      for (std::size_t c = 0; c < colliders.size(); ++c)
        if (c >= own.first && c < own.first + own.second)
          segments.skip();
        else
          segments.add(colliders[c]);
    }
  }

  void advance(std::size_t index) {
    StrandBundle bundle = bundle_at(index);
    spring_loops().advance_bundle(plan_, bundle);
    store(index, bundle.x, out_);
    store(index, bundle.v, out_ + 3 * particles());
    inside += bundle.inside;
    stretch = std::max(stretch, bundle.stretch);
  }

  std::int64_t touched(std::size_t step) const { return contact_counts_[step]; }
  std::int64_t inside = 0;
  double stretch = 0;

 private:
  std::size_t width() const { return WIDE_VECTOR * plan_.points; }
  std::size_t particles() const { return strands_.strands() * plan_.points; }

  StrandBundle bundle_at(std::size_t index) {
    StrandBundle built{};
    built.x = rows_.data();
    built.v = built.x + width();
    built.before = built.v + width();
    built.along = built.before + width();
    built.matrix = built.along + width();
    built.unmoved = built.matrix + width();
    built.rests = strands_.rests(index);
    built.folds = strands_.folds(index);
    built.shift = contact_shifts_.data();
    built.due = built.shift + plan_.points;
    built.dues = built.due + plan_.points;
    built.near = near_.data();
    built.touched = contact_counts_.data();
    built.at_segments = at_segments_.data();
    first_ = index * WIDE;
    for (std::size_t l = 0; l < WIDE; ++l) {
      const FaceContacts& segments = segments_of(l);
      if (!segments.any()) continue;
      const double reach = std::max(built.segments.reach, segments.reach());
      built.segments = {this, &Bundles::resolve_segments, reach};
    }
    built.next_depths = particles();
    for (std::size_t l = 0; l < WIDE; ++l) {
      if (index * WIDE + l < strands_.strands()) built.counted |= 1u << l;
      if (!colliders_.depths()) continue;
      const std::size_t strand = strand_of(index, l, strands_.strands());
      built.depths[l] = colliders_.depths() + strand * plan_.points;
    }
    load_strands(index, state_, built.x);
    load_strands(index, state_ + 3 * particles(), built.v);
    for (std::size_t k = 0; k <= plan_.cells; ++k)
      load_strands(index, targets_ + k * 3 * particles(), goals_.data() + k * width());
    built.goals = goals_.data();
    return built;
  }

  // One strand among rigid colliders.
  static bool resolve_segments(void* all, StrandBundle& bundle, std::size_t step, std::size_t lane,
                               std::size_t near) {
    auto& self = *static_cast<Bundles*>(all);
    FaceContacts& segments = self.segments_of(lane);
    if (!segments.any()) return false;
    const std::size_t points = self.plan_.points;
    self.near_segments_.assign(bundle.at_segments, bundle.at_segments + near);
    const auto each = [&](auto&& move) {
      for (std::size_t p = 0; p < points; ++p)
        for (std::size_t k = 0; k < 3; ++k) move(ROW * p + k, WIDE_VECTOR * p + WIDE * k + lane);
    };
    each([&](std::size_t to, std::size_t from) {
      self.row_before_[to] = bundle.unmoved[from], self.row_[to] = bundle.x[from];
    });
    bool moved = false;
    for (std::size_t c = 0; c < self.colliders_.size(); ++c) {
      if (!segments.resolve(c, self.frame_.row(step, c), self.plan_.h, self.near_segments_,
                            {self.row_before_, self.row_, nullptr}))
        continue;
      moved = true;
      for (const FaceContacts::MovedParticle& one : segments.moved)
        bundle.shift[static_cast<std::size_t>(one.particle)] += one.shift;
    }
    if (moved)
      each([&](std::size_t from, std::size_t to) {
        bundle.unmoved[to] = self.row_before_[from], bundle.x[to] = self.row_[from];
      });
    return moved;
  }

  FaceContacts& segments_of(std::size_t lane) {
    return segments_[strands_.segments_of(strand_of(first_ / WIDE, lane, strands_.strands()))];
  }

  // Converts rows of particles (N, 3) to interleaved rows of a bundle, and back.
  void load_strands(std::size_t index, const double* rows, double* out) const {
    for (std::size_t l = 0; l < WIDE; ++l) {
      const std::size_t strand = strand_of(index, l, strands_.strands());
      const double* row = rows + 3 * plan_.points * strand;
      for (std::size_t k = 0; k < 3 * plan_.points; ++k) out[WIDE * k + l] = row[k];
    }
  }
  void store(std::size_t index, const double* rows, double* out) const {
    for (std::size_t l = 0; l < WIDE && index * WIDE + l < strands_.strands(); ++l) {
      double* row = out + 3 * plan_.points * (index * WIDE + l);
      for (std::size_t k = 0; k < 3 * plan_.points; ++k) row[k] = rows[WIDE * k + l];
    }
  }

  const SpringStrands& strands_;
  const StrandSteps& plan_;
  const MovingColliders& colliders_;
  const FrameColliders& frame_;
  std::vector<FaceContacts> segments_;
  std::size_t first_ = 0;  // strand of the bundle
  const double *targets_, *state_;
  double* out_;
  std::vector<double> rows_, goals_, contact_shifts_;
  std::vector<std::size_t> near_;
  std::vector<std::int64_t> contact_counts_;
  std::vector<std::int32_t> at_segments_, near_segments_;
  std::vector<double> row_before_, row_;  // of one strand, in rows
};

// Smallest number of bundles per thread.
constexpr std::size_t MIN_BUNDLES = 16;

// Advances all bundles in several threads; results do not depend on their number.
void advance_all(std::vector<Bundles>& workers, std::size_t bundles) {
  const auto work = [&](std::size_t w) {
    const std::size_t end = (w + 1) * bundles / workers.size();
    for (std::size_t b = w * bundles / workers.size(); b < end; ++b) workers[w].advance(b);
  };
  std::vector<std::thread> others;
  others.reserve(workers.size());
  for (std::size_t w = 1; w < workers.size(); ++w) {
    try {
      others.emplace_back(work, w);
    } catch (const std::system_error&) {
      work(w);
    }
  }
  work(0);
  for (std::thread& one : others) one.join();
}

// Fraction of an elongation that a spring corrects in a step; stiffness and damping are per mass.
double compliance_of(double stiffness, double damping, double weight, double h) {
  return stiffness * h * h / ((stiffness * h * h + damping * h) * weight + 1);
}

}  // namespace

SpringStrands::SpringStrands(In<double, 2> rests, In<double, 2> folds, In<double, 1> gravity,
                             double drag, double stiffness, double fold_stiffness,
                             double draw_stiffness, double draw_damping, double stretch)
    : strands_(rests.shape(0)),
      points_(rests.shape(1) + 1),
      drag_(drag),
      stiffness_(stiffness),
      fold_(fold_stiffness),
      draw_(draw_stiffness),
      draw_damping_(draw_damping),
      stretch_(stretch) {
  check::shape("rests", rests, {check::ANY, check::ANY});
  if (strands_ == 0) check::refuse("rests", "there is no strand");
  check::at_most("rests", points_, check::MAX_ROWS / strands_);
  for (std::size_t k = 0; k < rests.size(); ++k) check::not_negative("rests", rests.data()[k]);
  check::shape("folds", folds, {strands_, points_ - std::min<std::size_t>(points_, 2)});
  for (std::size_t k = 0; k < folds.size(); ++k) check::not_negative("folds", folds.data()[k]);
  check::numbers("gravity", gravity, {3});
  check::finite("drag", drag);
  check::not_negative("stiffness", stiffness);
  check::not_negative("fold_stiffness", fold_stiffness);
  check::not_negative("draw_stiffness", draw_stiffness);
  check::not_negative("draw_damping", draw_damping);
  check::not_negative("stretch", stretch);
  std::copy_n(gravity.data(), 3, gravity_);
  rests_ = interleaved(rests, strands_, springs());
  folds_ = interleaved(folds, strands_, points_);
  group_segments(rests);
}

// Lengths are rounded up to powers of two, so that a strand collides as if it were alone.
void SpringStrands::group_segments(In<double, 2> rests) {
  SpringElements one;
  one.inverse_masses.assign(points_, 1.0);
  one.inverse_masses.front() = 0;
  for (std::size_t p = 0; p < springs(); ++p)
    for (const std::size_t end : {p, p + 1}) one.edges.push_back(static_cast<std::int32_t>(end));
  for (std::size_t s = 0; s < strands_; ++s) {
    const double* row = rests.data() + s * springs();
    const double longest = springs() ? *std::max_element(row, row + springs()) : 0.0;
    int power = 0;
    if (longest > 0) std::frexp(longest, &power);
    one.longest_edge = longest > 0 ? std::ldexp(1.0, power) : 0.0;
    const auto same = std::find_if(segments_.begin(), segments_.end(), [&](const auto& other) {
      return other.longest_edge == one.longest_edge;
    });
    segments_of_.push_back(static_cast<std::size_t>(same - segments_.begin()));
    if (same == segments_.end()) segments_.push_back(one);
  }
}

StrandSteps SpringStrands::plan(std::size_t cells, std::size_t substeps, double span) const {
  StrandSteps built{};
  built.points = points_;
  built.cells = cells;
  built.substeps = substeps;
  const double h = span / static_cast<double>(cells * substeps);
  built.h = h;
  for (std::size_t k = 0; k < 3; ++k) built.fall[k] = h * gravity_[k];
  built.drag_factor = 1 / (1 + h * drag_);
  built.fold = compliance_of(fold_, 0, 2, h);
  built.root_fold = compliance_of(fold_, 0, 1, h);
  built.draw = compliance_of(draw_, draw_damping_, 1, h);
  built.draw_change = draw_damping_ * h / ((draw_ * h * h + draw_damping_ * h) + 1);
  built.soft = 1 / (stiffness_ * h * h);
  built.longest = 1 + stretch_;
  return built;
}

StrandsFollowed follow_strands(const SpringStrands& strands, In<double, 3> targets,
                               In<double, 3> state, double span, int substeps,
                               const std::optional<SpringColliders>& colliders, std::size_t threads,
                               const CarrierColliders& own) {
  const std::size_t count = strands.strands() * strands.points();
  check::numbers("state", state, {2, count, 3});
  check::shape("targets", targets, {check::ANY, count, 3});
  if (targets.shape(0) < 2) check::refuse("targets", "there is no cell between two of them");
  check::finite("targets", targets);
  if (threads < 1) check::refuse("threads", "0 is none");
  const std::size_t cells = targets.shape(0) - 1;
  check::positive("span", span);
  check_cells({0, 0, span / static_cast<double>(cells), static_cast<std::int64_t>(cells)},
              substeps);
  const MovingColliders moving(colliders, count, static_cast<std::int64_t>(cells));
  Out<double, 3> out(2, count, 3);
  std::int64_t touched = 0, inside = 0;
  double stretch = 0;
  StrandSteps plan = strands.plan(cells, static_cast<std::size_t>(substeps), span);
  const FrameColliders frame(moving, colliders, cells, substeps, plan.h, targets.data(), count);
  frame.fill(plan);
  const std::size_t bundles = bundles_of(strands.strands());
  const std::size_t max_workers = std::max<std::size_t>(1, bundles / MIN_BUNDLES);
  std::vector<Bundles> workers;
  workers.reserve(std::min(threads, max_workers));
  while (workers.size() < std::min(threads, max_workers))
    workers.emplace_back(strands, plan, moving, frame, own, targets.data(), state.data(),
                         out.get());
  advance_all(workers, bundles);
  for (std::size_t step = 0; step < cells * static_cast<std::size_t>(substeps); ++step) {
    std::int64_t step_count = 0;
    for (const Bundles& one : workers) step_count += one.touched(step);
    touched = std::max(touched, step_count);
  }
  for (const Bundles& one : workers) {
    inside += one.inside;
    stretch = std::max(stretch, one.stretch);
  }
  return {std::move(out), touched, inside, stretch};
}

}  // namespace animtool
