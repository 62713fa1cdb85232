"""The monitor as a service: many axes, their data as they come, what is known of them kept and given out.

    sources --> deliveries --> order --> fleets of monitors --> rows and notices --> sinks, board --> page
                                            |
                                            +--> checkpoints --> deliveries are acknowledged

One thread, the engine's, owns everything that is estimated. Sources hand it deliveries through a bounded inbox and wait
where it is full. What it finds it offers to outlets, which never make it wait: each has a bounded queue and counts what
it drops.
"""
