#pragma once

/// The same source for wider registers, chosen at run time. Without contraction and reordering all
/// clones give the same bits. Sanitizers meet the dispatcher before they are ready, so they get the
/// portable build.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__SANITIZE_ADDRESS__) && \
    !defined(__SANITIZE_THREAD__)
#define SEKITEI_CLONES __attribute__((target_clones("avx2", "default")))
#define SEKITEI_CLONES_512 __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define SEKITEI_CLONES
#define SEKITEI_CLONES_512
#endif
