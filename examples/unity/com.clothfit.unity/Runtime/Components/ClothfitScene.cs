using System.Collections.Generic;
using UnityEngine;

namespace Clothfit
{
    /// <summary>How the cloth moves on in time.</summary>
    public enum Integrator
    {
        [Tooltip("Explicit Euler: needs very small time steps")]
        Explicit = 0,

        [Tooltip("Symplectic Euler: needs small time steps")]
        Symplectic = 1,

        [Tooltip("Implicit Euler: stable, and damps fast waves")]
        Implicit = 2,

        [Tooltip("BDF2: of second order, damps little")]
        Bdf2 = 3,
    }

    /// <summary>
    /// A scene to simulate and fit: its settings, and what is fitted of it as a whole. The cloths, fixers, obstacles and
    /// the wind are components on this object and those below it.
    /// </summary>
    [AddComponentMenu("Clothfit/Scene")]
    [DisallowMultipleComponent]
    public class ClothfitScene : MonoBehaviour
    {
        [Header("Steps")]
        [Tooltip("How the cloth moves on in time")]
        public Integrator integrator = Integrator.Implicit;

        [Tooltip("Time step, s")]
        [Min(1e-6f)]
        public float timeStep = 0.02f;

        [Tooltip("Relative tolerance of the linear solver, 0 to 1")]
        public float tolerance = 1e-5f;

        [Tooltip("Frames that a fit compares, the first included: 100 frames are 99 steps")]
        [Min(2)]
        public int frames = 100;

        [Tooltip("Newton iterations of a step; 1 is the linearised step")]
        [Min(1)]
        public int newtonIterations = 1;

        [Header("World")]
        [Tooltip("Whether gravity is another than 9.81 m/s² downwards")]
        public bool ownGravity;

        [Tooltip("Gravity, m/s²")]
        public Vector3 gravity = new Vector3(0f, -9.81f, 0f);

        [Tooltip("What is added to gravity over time, m/s²")]
        public TimedKeys gravityKeys = new TimedKeys();

        [Tooltip("Whether planes are solid; in scenes of old editors they are not")]
        public bool solidPlanes = true;

        [Tooltip("Whether a cloth does not pass through itself, and how it touches itself")]
        public Contact selfContact = new Contact { thickness = 0.005f };

        [Tooltip("How far all obstacles are from where they stand, m")]
        public Vector3 obstacleOffset;

        [Header("Fit")]
        [Tooltip("The motion to match, a path in the project folder or absolute; empty: a trial on the scene's own motion")]
        public string target = "";

        [Tooltip("Frames per second of the target, 1/s; 0: the file says it, or it has a frame for each time step")]
        [Min(0f)]
        public float targetRate;

        [Tooltip("Fit the wind")]
        public bool fitWind;

        [Tooltip("Fit the wind of each of its keys")]
        public bool fitWindKeys;

        [Tooltip("Fit gravity")]
        public bool fitGravity;

        [Tooltip("Fit the friction of obstacles with own contact, and of self-contact")]
        public Fitted fitFriction;

        [Tooltip("Fit the stiffness of obstacles with own contact, and of self-contact")]
        public Fitted fitContact;

        [Tooltip("Fit one vector by which all obstacles stand elsewhere")]
        public bool fitObstacleOffset;

        [Tooltip("Lowest and highest values for all cloths and the scene")]
        public List<FitBounds> bounds = new List<FitBounds>();

        [Tooltip("More options of clothfit estimate, separated by spaces, such as --holdout 0.2")]
        public string options = "";

        /// <summary>The components of a kind on this object and below it, that are switched on, in the order of the hierarchy.</summary>
        public List<T> All<T>() where T : MonoBehaviour
        {
            var found = new List<T>();
            foreach (T each in GetComponentsInChildren<T>())
                if (each.enabled) found.Add(each);
            return found;
        }
    }
}
