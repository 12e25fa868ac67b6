// Springs four at a time for processors with registers of four doubles.
#include "springs/loops.h"

namespace animtool {

const SpringFunctions* springs_in_quads() {
  return has_quads() ? &spring_functions_on<Quads> : nullptr;
}

}  // namespace animtool
