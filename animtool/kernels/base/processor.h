// What the processor has beyond what every one of its kind has.
#pragma once

#include <cstdlib>

namespace animtool {

// Whether registers of four doubles may be used. ANIMTOOL_PORTABLE, set to anything, goes
// without, as on processors that have none. Static: a source built for newer processors
// must not give its copy to the others.
[[maybe_unused]] static bool has_quads() {
#if defined(__x86_64__) && defined(__GNUC__)
  return __builtin_cpu_supports("avx2") && !std::getenv("ANIMTOOL_PORTABLE");
#else
  return false;
#endif
}

}  // namespace animtool
