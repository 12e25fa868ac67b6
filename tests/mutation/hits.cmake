# Included by the kernels' CMakeLists: builds them quickly, with vectors that end the
# process where an index is beyond them, and with KERNEL_HITS so that they mark which of
# their code runs.
set(hits_source ${CMAKE_CURRENT_LIST_DIR}/hits.cpp)

function(build_for_mutation)
  get_target_property(sources kernels SOURCES)
  set_property(TARGET kernels PROPERTY DISABLE_PRECOMPILE_HEADERS ON)
  set_property(SOURCE ${sources} APPEND PROPERTY COMPILE_OPTIONS
    -O1 -w -D_GLIBCXX_ASSERTIONS)
  if(KERNEL_HITS)
    # Addresses of inlined calls are read from DWARF 4 alone by some versions of binutils.
    set_property(SOURCE ${sources} APPEND PROPERTY COMPILE_OPTIONS
      -fsanitize-coverage=trace-pc -gdwarf-4 -fno-reorder-blocks)
    target_sources(kernels PRIVATE ${hits_source})
  endif()
endfunction()
cmake_language(DEFER CALL build_for_mutation)
