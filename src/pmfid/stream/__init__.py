"""Steps many axes as their blocks arrive: `pmfid serve` and the streams of a fleet share this package.

    deliveries --> order --> fleets of monitors --> rows and notices --> outlets
                                     |
                                     +--> snapshots

Nothing here knows a broker, a web page or a cluster.
"""
