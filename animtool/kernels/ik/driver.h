// Driven joints: values are expressions of other joints; derivatives by forward mode.
//
// A program is in reverse Polish notation, over coordinates and the results of earlier
// programs. Derivatives are by the degrees of freedom that it reads.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "base/quaternions.h"

namespace animtool::ik {

// As in animtool.ik.driver_programs; the functions are those of a rig's expressions.
enum class Op {
  NUMBER,
  COORDINATE,
  BALL,
  RESULT,
  POINT,
  CURVE,
  ADD,
  SUBTRACT,
  MULTIPLY,
  DIVIDE,
  NEGATE,
  ABS,
  ATAN2,
  CEIL,
  CLAMP,
  COS,
  EXP,
  FLOOR,
  LERP,
  LOG,
  MAX,
  MIN,
  POW,
  SIGN,
  SIN,
  SMOOTHSTEP,
  SQRT,
  TAN,
  COUNT
};

// Numbers of an instruction.
constexpr int MAX_NUMBERS = 6;
// Largest stack depth of a program, and largest number of derivatives of a value.
constexpr std::size_t MAX_STACKED = 1024, MAX_SLOPES = 1024;

inline int arguments(Op op) {
  switch (op) {
    case Op::NUMBER:
    case Op::COORDINATE:
    case Op::BALL:
    case Op::RESULT:
    case Op::POINT:
      return 0;
    case Op::CLAMP:
    case Op::LERP:
    case Op::SMOOTHSTEP:
      return 3;
    case Op::ADD:
    case Op::SUBTRACT:
    case Op::MULTIPLY:
    case Op::DIVIDE:
    case Op::ATAN2:
    case Op::MAX:
    case Op::MIN:
    case Op::POW:
      return 2;
    default:
      return 1;
  }
}

struct Instruction {
  Op op;
  // COORDINATE and BALL: the coordinate; RESULT: the program; CURVE: its points' count.
  int which;
  // NUMBER: its value; POINT: x, y, slope; CURVE: whether it is smooth; COORDINATE: scale; BALL:
  // factors of the twist, the swing about x and y, and the swing angle, and the middle of the
  // twist's range.
  double numbers[MAX_NUMBERS];
  int slot;  // of the first degree of freedom, among the program's
};

struct Program {
  std::vector<Instruction> instructions;
  std::vector<int> dofs;  // degrees of freedom that it depends on, ascending
  std::size_t first = 0;  // of its slopes, among those of all programs
  std::size_t depth = 0;  // largest stack depth
};

// Results of programs at a pose.
struct Results {
  std::vector<double> values, slopes;
  std::vector<double> stack;
};

// Twist and swing of a ball, and their derivatives for q <- exp(d) q.
struct BallParts {
  double twist, swing[2];
  double slopes[3][3];
};

// In `ik/limits.cpp`, which knows how to split a ball's motion.
BallParts ball_parts(const double* q, double middle);

class Evaluation {
 public:
  Evaluation(const std::vector<Program>& programs, const double* q, Results& results)
      : programs_(programs), q_(q), results_(results) {}

  void run() {
    for (std::size_t p = 0; p < programs_.size(); ++p) run(p);
  }

 private:
  void run(std::size_t p);

  double* at(std::size_t i) { return &results_.stack[i * (1 + slots_)]; }

  double* push(double value) {
    double* top = at(top_++);
    top[0] = value;
    std::fill(top + 1, top + 1 + slots_, 0.0);
    return top + 1;
  }

  // The result of one, two or three operands replaces the first.
  void replace_operands(int count, double value, double a, double b = 0, double c = 0);

  void apply(const Program& program, const Instruction& one, const Instruction* points);

  void ball(const Instruction& one);

  void result(const Program& program, const Instruction& one);

  void curve(const Instruction& one, const Instruction* points);

  void function(Op op);

  void smoothstep(const double* x);

  const std::vector<Program>& programs_;
  const double* q_;
  Results& results_;
  std::size_t slots_ = 0, top_ = 0;
};

}  // namespace animtool::ik
