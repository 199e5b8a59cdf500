// Success of RVO2 in the rooms of GLAS, for table `glas` of `bulletuav reproduce`.
//
// Build, with RVO2 = a clone of https://github.com/snape/RVO2 at commit 1c25b27:
//   g++ -std=c++17 -O2 -DRVO_STATIC_DEFINE -I RVO2/src benchmarks/rvo2_rooms.cpp RVO2/src/*.cc
// Run: python benchmarks/rvo2_rooms.py ./a.out GLAS, with GLAS = the data of the table.
//
// Input, m: for each room, the numbers of robots and of squares and the lengths of the room; start
// and goal of each robot; lower corner of each square of 1 m.
// Output: for each room, the number of robots that reach their goals without collision.

#include <algorithm>
#include <cmath>
#include <iostream>
#include <vector>

#include "RVOSimulator.h"
#include "Vector2.h"

// Settings of baseline/orca/orca.cpp and results/singleintegrator/stats.py of GLAS
constexpr float PERIOD = 0.05F, SENSING_RANGE = 3.0F, HORIZON = 1.0F, RADIUS = 0.16F, SPEED = 0.5F;
constexpr int NUM_SEEN = 5, NUM_STEPS = 1000;
constexpr double ROBOT_RADIUS = 0.15, SLACK = 1e-4, GOAL_DISTANCE = 0.5, ARRIVED = 0.05;

static double distance(const RVO::Vector2 &a, const RVO::Vector2 &b) {
  return std::hypot(double(a.x()) - b.x(), double(a.y()) - b.y());
}

static void add_box(RVO::RVOSimulator &world, float x, float y, float right, float top) {
  world.addObstacle({{x, y}, {right, y}, {right, top}, {x, top}});
}

int main() {
  int robots, squares;
  float width, height;
  while (std::cin >> robots >> squares >> width >> height) {
    RVO::RVOSimulator world;
    world.setTimeStep(PERIOD);
    world.setAgentDefaults(SENSING_RANGE, NUM_SEEN, HORIZON, HORIZON, RADIUS, SPEED);
    std::vector<RVO::Vector2> goal, square;
    for (int i = 0; i < robots; ++i) {
      float x, y, goal_x, goal_y;
      std::cin >> x >> y >> goal_x >> goal_y;
      world.addAgent({x, y});
      goal.emplace_back(goal_x, goal_y);
    }
    for (int k = 0; k < squares; ++k) {
      float x, y;
      std::cin >> x >> y;
      square.emplace_back(x, y);
      add_box(world, x, y, x + 1, y + 1);
    }
    add_box(world, -1, -1, 0, height);
    add_box(world, width, -1, width + 1, height);
    add_box(world, 0, -1, width + 1, 0);
    add_box(world, 0, height, width + 1, height + 1);
    world.processObstacles();

    std::vector<bool> collided(robots, false);
    for (int step = 0; step <= NUM_STEPS; ++step) {
      bool all_arrived = true;
      for (int i = 0; i < robots; ++i) {
        const RVO::Vector2 here = world.getAgentPosition(i);
        for (int j = 0; j < i; ++j) {
          if (distance(here, world.getAgentPosition(j)) < 2 * ROBOT_RADIUS - SLACK) {
            collided[i] = collided[j] = true;
          }
        }
        for (const RVO::Vector2 &low : square) {
          const RVO::Vector2 nearest(std::clamp(here.x(), low.x(), low.x() + 1),
                                     std::clamp(here.y(), low.y(), low.y() + 1));
          if (distance(here, nearest) < ROBOT_RADIUS - SLACK) collided[i] = true;
        }
        const RVO::Vector2 ahead = goal[i] - here;
        all_arrived = all_arrived && distance(here, goal[i]) <= ARRIVED;
        world.setAgentPrefVelocity(i, ahead / std::max(1.0F, RVO::abs(ahead)));
      }
      if (all_arrived || step == NUM_STEPS) break;
      world.doStep();
    }
    int succeeded = 0;
    for (int i = 0; i < robots; ++i) {
      succeeded += !collided[i] && distance(world.getAgentPosition(i), goal[i]) <= GOAL_DISTANCE;
    }
    std::cout << succeeded << std::endl;
  }
}
