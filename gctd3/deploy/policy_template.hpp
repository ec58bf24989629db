// A walking policy for @ROBOT@, written by gctd3 @VERSION@ (python -m gctd3.export out=NAME.hpp). C++17, no dependencies.
//
//   @NAMESPACE@::Policy policy;
//   double readings[@NAMESPACE@::READINGS], command[@NAMESPACE@::SERVOS];
//   // Once a control period, @PERIOD@ s; `command` is safe to send whatever is returned.
//   if (const char* reason = policy.step(readings, time, command)) log(reason);
//
// READING_NAMES, commands among them, and SERVO_NAMES give the order of both arrays, angles in rad. Before a walk call start() until at_home().
// The meaning of every number is in CONTRACT, and in docs/safety.md of gctd3. No memory is allocated, nothing is thrown.
#pragma once

#include <cmath>
#include <limits>

#ifdef __FAST_MATH__
#error "Compile without -ffast-math: a NaN among the readings must be seen."
#endif

namespace @NAMESPACE@ {

@CONTRACT@

// The network. Source: the operators of https://onnx.ai/onnx/operators.
namespace network {

// y [M, N] = a [M, K] b [K, N]
template <int M, int K, int N>
inline void multiply(const float* a, const float* b, float* y) {
  for (int i = 0; i < M; ++i) {
    for (int j = 0; j < N; ++j) y[i * N + j] = 0.0f;
    for (int k = 0; k < K; ++k)
      for (int j = 0; j < N; ++j) y[i * N + j] += a[i * K + k] * b[k * N + j];
  }
}

// y [M, N] = a [M, K] b [N, K]'
template <int M, int K, int N>
inline void multiply_transposed(const float* a, const float* b, float* y) {
  for (int i = 0; i < M; ++i)
    for (int j = 0; j < N; ++j) {
      float sum = 0.0f;
      for (int k = 0; k < K; ++k) sum += a[i * K + k] * b[j * K + k];
      y[i * N + j] = sum;
    }
}

template <int ROWS, int WIDTH>
inline void layer_norm(const float* x, const float* scale, const float* bias, float epsilon, float* y) {
  for (int i = 0; i < ROWS; ++i) {
    float mean = 0.0f, variance = 0.0f;
    for (int k = 0; k < WIDTH; ++k) mean += x[i * WIDTH + k];
    mean /= WIDTH;
    for (int k = 0; k < WIDTH; ++k) variance += (x[i * WIDTH + k] - mean) * (x[i * WIDTH + k] - mean);
    const float factor = 1.0f / std::sqrt(variance / WIDTH + epsilon);
    for (int k = 0; k < WIDTH; ++k)
      y[i * WIDTH + k] = (x[i * WIDTH + k] - mean) * factor * scale[k] + (bias ? bias[k] : 0.0f);
  }
}

template <int ROWS, int WIDTH>
inline void softmax(const float* x, float* y) {
  for (int i = 0; i < ROWS; ++i) {
    float most = x[i * WIDTH], sum = 0.0f;
    for (int k = 1; k < WIDTH; ++k) most = x[i * WIDTH + k] > most ? x[i * WIDTH + k] : most;
    for (int k = 0; k < WIDTH; ++k) sum += y[i * WIDTH + k] = std::exp(x[i * WIDTH + k] - most);
    for (int k = 0; k < WIDTH; ++k) y[i * WIDTH + k] /= sum;
  }
}

inline void copy(const float* x, float* y, int size) {
  for (int i = 0; i < size; ++i) y[i] = x[i];
}

@CONSTANTS@

// Computes the action [SERVOS] in [-1, 1] of the features [NODES, FRAMES * FEATURES].
inline void run(const float* nodes, float* action, float* scratch) {
@STATEMENTS@
}

}  // namespace network

// Runs the policy, one call a control period.
class Policy {
 public:
  Policy() { reset(true); }

  // Forgets history, clock and stop: needed after a stop, and after the clock was set back. at_home: the robot has been
  // put into its home pose meanwhile; by default the command stays, so that it does not jump.
  void reset(bool at_home = false) {
    forget();
    starting_ = stopped_ = at_home_ = false;
    if (!at_home) return;
    periods_ = 0;
    for (int i = 0; i < SERVOS; ++i) angles_[i] = HOME[i];
  }

  // Computes the desired joint angles (rad) of one control step. Returns nullptr; or the reason for which `command` is
  // the safe command. readings: in the order of READING_NAMES. time: of the readings (s), on any steady clock.
  const char* step(const double* readings, double time, double* command) {
    starting_ = at_home_ = false;
    const char* reason = advance(readings, time);
    if (reason) refuse();
    write(command);
    return reason;
  }

  // Moves the joints from where they are to the home pose, one control period a call, until at_home().
  const char* start(const double* readings, double* command) {
    const char* reason = nullptr;
    if (!CAN_START) reason = "This policy does not read the angle of every joint.";
    else reason = check(readings);
    at_home_ = false;
    if (reason) {
      refuse();
    } else {
      if (!starting_) {
        forget();
        for (int i = 0; i < SERVOS; ++i) angles_[i] = clip(readings[ANGLE[i]], LOW[i], HIGH[i]);
      }
      starting_ = true;
      periods_ = 0;
      approach();
      at_home_ = true;
      for (int i = 0; i < SERVOS; ++i)
        if (angles_[i] != HOME[i]) at_home_ = false;
    }
    write(command);
    return reason;
  }

  // Whether the last call was a start() that arrived at the home pose.
  bool at_home() const { return at_home_; }

  // Whether a tilt has stopped the policy until reset().
  bool stopped() const { return stopped_; }

  // Control periods since the last good command; the command is held for HOLD of them.
  int periods() const { return periods_; }

 private:
  static constexpr double NEVER = -std::numeric_limits<double>::infinity(), TURN = 6.283185307179586;

  static double clip(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

  void forget() {
    filled_ = late_known_ = false;
    time_ = frame_time_ = NEVER;
    for (float& x : action_) x = 0.0f;
  }

  void write(double* command) const {
    for (int i = 0; i < SERVOS; ++i) command[i] = angles_[i];
  }

  void refuse() {
    if (periods_ < std::numeric_limits<int>::max()) ++periods_;
    if (periods_ > HOLD) approach();
  }

  void approach() {
    for (int i = 0; i < SERVOS; ++i) {
      const double away = HOME[i] - angles_[i];
      angles_[i] = std::fabs(away) <= HOME_STEP[i] ? HOME[i] : angles_[i] + clip(away, -HOME_STEP[i], HOME_STEP[i]);
    }
  }

  const char* check(const double* readings) {
    if (stopped_) return "Stopped: the body was tilted too far. Call reset() to go on.";
    for (int i = 0; i < READINGS; ++i) {
      if (!std::isfinite(readings[i])) return "A reading is not finite.";
      if (BINARY[i] && readings[i] != 0.0 && readings[i] != 1.0) return "A reading must be 0 or 1.";
      if (!(readings[i] >= LEAST[i] && readings[i] <= MOST[i])) return "A reading is beyond its limits.";
    }
    double upright = 1.0;
    for (int i = 0; i < TILTS; ++i) upright *= BY_GRAVITY ? -readings[TILT[i]] : std::cos(readings[TILT[i]]);
    if (MOST_TILT > 0.0 && std::acos(clip(upright, -1.0, 1.0)) > MOST_TILT) {
      stopped_ = true;
      return "Stopped: the body was tilted too far. Call reset() to go on.";
    }
    return nullptr;
  }

  const char* check_time(double time) {
    if (!std::isfinite(time)) return "time must be a finite number of seconds.";
    if (time < time_) return "The clock went back. If it was set back, call reset().";
    if (time - frame_time_ < 0.5 * PERIOD) return "Stale readings: they are no newer than those before.";
    const double most = (HOLD + 1.5) * PERIOD, since = time - time_;
    const bool again = late_known_ && time - late_ >= 0.0 && time - late_ <= most;
    if (since > most && since < std::numeric_limits<double>::infinity() && !again) {
      late_ = time;
      late_known_ = true;
      return "Steps were missed. The next readings begin a new history.";
    }
    time_ = time;
    late_known_ = false;
    return nullptr;
  }

  const char* advance(const double* readings, double time) {
    if (const char* reason = check_time(time)) return reason;
    if (const char* reason = check(readings)) return reason;
    double missed = (time - frame_time_) / PERIOD - 1.0;
    missed = missed < 0.0 ? 0.0 : missed;
    const bool anew = !filled_ || missed >= HOLD + 0.5;
    // Commands with a slew rate are approached, from the one that is nearest to 0 on.
    double told[READINGS];
    for (int i = 0; i < READINGS; ++i) {
      const double last = anew ? clip(0.0, LEAST[i], MOST[i]) : told_[i], away = readings[i] - last;
      told[i] = SLEW[i] > 0.0 && std::fabs(away) > SLEW[i] ? last + std::copysign(SLEW[i], away) : readings[i];
    }
    float frame[NODES * FEATURES] = {};
    for (int i = 0; i < READINGS; ++i) frame[PLACE[i]] = static_cast<float>(told[i] - ZERO[i]);
    for (int i = 0; i < OWN; ++i) frame[OWN_PLACE[i]] = action_[OWN_SERVO[i]];
    const double elapsed = filled_ ? time - began_ : 0.0;
    for (int i = 0; i < CLOCKS; ++i)
      frame[CLOCK_PLACE[i]] = static_cast<float>(std::sin(TURN * (CLOCK_HZ[i] * elapsed + CLOCK_PHASE[i])));
    float history[FRAMES][NODES * FEATURES];
    // Halves are rounded to the even number, as Python does.
    const int repeats = anew ? 0 : static_cast<int>(std::nearbyint(missed));
    for (int f = 0; f < FRAMES; ++f) {
      const int from = f + repeats + 1;
      const bool old = !anew && from < FRAMES + repeats;
      const float* source = frame;
      if (f < FRAMES - 1 && old) source = history_[from < FRAMES ? from : FRAMES - 1];
      network::copy(source, history[f], NODES * FEATURES);
    }
    float nodes[NODES * FRAMES * FEATURES], action[SERVOS];
    for (int n = 0; n < NODES; ++n)
      for (int f = 0; f < FRAMES; ++f)
        network::copy(history[f] + n * FEATURES, nodes + (n * FRAMES + f) * FEATURES, FEATURES);
    network::run(nodes, action, scratch_);
    for (int i = 0; i < SERVOS; ++i)
      if (!std::isfinite(action[i])) return "The policy's output is not finite.";
    for (int i = 0; i < SERVOS; ++i) {
      const double desired = clip(CENTRE[i] + SCALE[i] * static_cast<double>(action[i]), LOW[i], HIGH[i]);
      angles_[i] = clip(clip(desired, angles_[i] - MOST_CHANGE[i], angles_[i] + MOST_CHANGE[i]), LOW[i], HIGH[i]);
    }
    for (int f = 0; f < FRAMES; ++f) network::copy(history[f], history_[f], NODES * FEATURES);
    for (int i = 0; i < READINGS; ++i) told_[i] = told[i];
    network::copy(action, action_, SERVOS);
    if (!filled_) began_ = time;
    filled_ = true;
    frame_time_ = time;
    periods_ = 0;
    return nullptr;
  }

  double angles_[SERVOS] = {}, told_[READINGS] = {}, time_ = NEVER, frame_time_ = NEVER, began_ = 0.0, late_ = 0.0;
  float action_[SERVOS] = {}, history_[FRAMES][NODES * FEATURES] = {}, scratch_[@SCRATCH@] = {};
  int periods_ = 0;
  bool filled_ = false, late_known_ = false, starting_ = false, stopped_ = false,
       at_home_ = false;
};

}  // namespace @NAMESPACE@
