using UnityEngine;

namespace Clothfit
{
    /// <summary>The wind of a scene, everywhere the same.</summary>
    [AddComponentMenu("Clothfit/Wind")]
    [DisallowMultipleComponent]
    public class ClothfitWind : MonoBehaviour
    {
        [Tooltip("Velocity of the air, m/s")]
        public Vector3 velocity;

        [Tooltip("What is added to it over time, m/s")]
        public TimedKeys keys = new TimedKeys();

        void OnDrawGizmosSelected()
        {
            Gizmos.color = Color.cyan;
            Gizmos.DrawRay(transform.position, velocity);
        }
    }
}
